"""Installs the package into a workspace of colcon."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup

ABOUT = ElementTree.parse('package.xml')
NAME = ABOUT.findtext('name')
MAINTAINER = ABOUT.find('maintainer')

setup(
    name=NAME,
    version=ABOUT.findtext('version'),
    description=' '.join(ABOUT.findtext('description').split()),
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.attrib['email'],
    license=ABOUT.findtext('license'),
    packages=[NAME],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml', 'README.md', 'LICENSE']),
        *((f'share/{NAME}/{folder}', [str(file) for file in sorted(Path(folder).iterdir())])
          for folder in ('launch', 'config')),
    ],
    zip_safe=True,
    entry_points={'console_scripts': [f'mecanum_hil = {NAME}.node:main']},
)
