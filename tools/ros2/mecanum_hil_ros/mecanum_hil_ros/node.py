"""The node, for ``ros2 run`` and launch files: becomes the command ``hil ros2`` of mecanum-hil."""

import os
import shutil
import sys


def main():
    """Become ``hil ros2`` with the same arguments; end with exit code 2 where there is none."""
    hil = shutil.which('hil')
    if hil is None:
        sys.exit('mecanum_hil: there is no command hil on the PATH; '
                 'install mecanum-hil with pip (README.md of mecanum_hil_ros says how)')
    os.execv(hil, [hil, 'ros2', *sys.argv[1:]])
