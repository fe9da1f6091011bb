"""Text that a stranger wrote: an FMU's messages, its last words, what it says of itself."""


def one_line(text: str) -> str:
    """Return the text in one line, without signs that a terminal would obey.

    >>> one_line("red: \\x1b[31m,\\nend")
    'red: [31m, end'
    """
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
