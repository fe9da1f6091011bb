"""Which texts of the product are sentences of failure, and which words of them a test must quote."""

from tools.unquoted import runs, sentences

MODULE = '''
"""A module that is not damaged at all."""
STATES = {1: "the link was lost", 2: "the link is well"}
app = Option(help="whether it is not to be done")

def drive(name: str, given: bool) -> str:
    """Return what is not known."""
    if not name:
        raise DeviceError(f"robot {name}: {'look at its power' if given else name}; try again later")
    return f"{name} cannot be driven now" if given else "it drives very well"
'''


def test_what_errors_functions_and_tables_tell_of_failures_is_listed() -> None:
    assert [(one.line, one.parts) for one in sentences("hil/wire/some.py", MODULE)] == [
        (3, ("the link was lost",)),
        (9, ("look at its power",)),
        (9, ("robot ", ": ", "; try again later")),
        (10, (" cannot be driven now",)),
    ]


def test_a_pattern_quotes_as_a_text_does_but_not_across_what_is_filled_in() -> None:
    assert runs(r"takes 5\.5 s: expected 3\.0") == {"takes 5.5 s", "5.5 s expected", "s expected 3.0"}
    assert [one.runs for one in sentences("some.py", 'raise LinkError(f"the link {a} is lost now")')] == [
        {"is lost now"}
    ]
