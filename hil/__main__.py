"""``python -m hil`` is the command ``hil``, which begins here."""

from hil.core.interrupts import ends_at_once


def main() -> None:
    """Entry point."""
    with ends_at_once():
        from hil.cli.main import main as command
    command()


if __name__ == "__main__":
    main()
