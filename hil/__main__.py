"""``python -m hil`` is the command ``hil``."""

from hil.cli.main import main

main()
