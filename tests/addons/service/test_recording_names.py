"""Names that clients give recordings."""

import shlex

from hypothesis import example, given
from hypothesis import strategies as st

from hil.addons.service.records import named_in
from hil.core.errors import BadInputError


@given(st.text(min_size=1, max_size=12).map(lambda stem: f"{stem}.rrd"))
@example("-rf.rrd")
@example("$(id).rrd")
@example(" x.rrd")
@example("~.rrd")
@example("x\u00a0y.rrd")
@example("\udcff.rrd")
@example("Müller_2025-11-02+a@b.rrd")
def test_a_client_s_name_for_a_recording_is_for_any_shell_and_command_a_name_alone(tmp_path_factory, name: str) -> None:
    folder = tmp_path_factory.getbasetemp()
    try:
        path = named_in(folder, name)
    except BadInputError:
        may = name.isascii() and name[0].isalnum() and shlex.quote(name) == name and not set(name) & set("%:/")
        assert not may
        return
    assert path == folder / name
    letters = "".join(one if one.isascii() else "x" for one in name)  # quote() knows no others
    assert shlex.quote(letters) == letters
    assert letters[0] not in "-.~"
    assert name.isprintable()
    assert not any(one.isspace() for one in name)
