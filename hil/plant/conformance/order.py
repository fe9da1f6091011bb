"""The parts of the conformance test in their order: what may crash an FMU comes late."""

from hil.plant.conformance import misuse, parts

GATES: tuple[parts.Part, ...] = (parts.functions, parts.life_cycle)  # where these fail, no other part can run
PARTS: tuple[parts.Part, ...] = (
    *GATES,
    parts.start_values,
    parts.variables,
    parts.initialization,
    parts.time,
    parts.step_size,
    parts.saved_state,
    parts.termination,
    parts.reset,
    parts.two_instances,
    parts.many_instances,
    misuse.values_out_of_range,
    misuse.illegal_calls,
)

ADVISORY = (misuse.values_out_of_range, misuse.illegal_calls)  # what an FMU does there is advice, also a crash


def title(part: parts.Part) -> str:
    """Return the part's name as a user reads it."""
    return part.__name__.replace("_", " ")
