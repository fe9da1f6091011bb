"""Checks of a campaign's runs before the first one begins: everything for which a run would be refused."""

from hil.core.errors import BadInputError
from hil.runtime.parts import RunParts
from hil.runtime.robots import check_plant_start, needed_truth
from hil.scenario import Scenario
from hil.wire.url import parse_link


def check_run(scenario: Scenario, made: set[tuple[str, ...]], *, allow_motion: bool) -> None:
    """Raise BadInputError for a run that would be refused.

    ``made`` collects the choices of laws and references that were tried before; each is tried once.
    """
    _check_link(scenario, allow_motion=allow_motion)
    check_plant_start(scenario)
    for row in scenario.expect:
        if row.from_s >= scenario.loop.duration_s:
            raise BadInputError(
                f"the expectation of {row.signal} begins at {row.from_s:g} s, and the run ends at "
                f"{scenario.loop.duration_s:g} s: it would always fail; give another, or expect = [] in [set] and "
                "[[expect]] rows of the campaign's own"
            )
    controller, reference = scenario.controller, scenario.reference
    gains = (controller.gains, controller.shadow_gains)
    choice = (controller.law, *controller.shadow, reference.kind, *map(repr, (*gains, reference.options)))
    if choice not in made:
        made.add(choice)
        RunParts(scenario)


def _check_link(scenario: Scenario, *, allow_motion: bool) -> None:
    """Raise BadInputError for a run over an external link that could not begin with any robot."""
    if parse_link(scenario.link.url).is_within_process:
        return
    where, is_makers = f"link.url = {scenario.link.url!r}", scenario.device.is_makers
    if (setting := needed_truth(scenario.estimator)) is not None:
        raise BadInputError(
            f'{where}: {setting}, and of a robot behind a link no truth is known; give estimator.source = "odometry"'
        )
    if is_makers and scenario.loop.mode == "lockstep":
        raise BadInputError(
            f"{where}: the protocol of {scenario.device.driver!r} has no STEP, so that nobody can let its time pass "
            'from outside; give loop.mode = "realtime", or link.url = "memory:"'
        )
    if is_makers and not allow_motion:
        raise BadInputError(
            f"{where}: the robot has motor controllers: real motors would move; add --allow-motion when it may move"
        )


def needs_bench(scenario: Scenario) -> bool:
    """Return whether a run needs the one hardware bench: a robot behind a link, or a source of pose fixes."""
    is_fixed_from_outside = scenario.estimator.source == "fused" and scenario.estimator.fix != "simulated"
    return is_fixed_from_outside or not parse_link(scenario.link.url).is_within_process
