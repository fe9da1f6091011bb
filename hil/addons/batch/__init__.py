"""Many runs on one engine: compare, campaign, hunt, catalogue, reproduce and baseline. README.md has the map."""

from hil.core.extensions import Command

COMMANDS = {
    "baseline": Command(
        "Run",
        "hil.addons.batch.baselines:baseline",
        "Write the figures of a scenario's runs beside it, for later runs to be compared with.",
    ),
    "compare": Command(
        "Compare and repeat",
        "hil.addons.batch.comparison.comparison_page:command",
        "Run laws under the same conditions and print one table for each; exit 1 when a run failed.",
    ),
    "campaign": Command(
        "Compare and repeat",
        "hil.addons.batch.campaign_command:app",
        "Run a scenario thousands of times, over axes, laws, faults and seeds, and judge it on one page.",
    ),
    "hunt": Command(
        "Compare and repeat",
        "hil.addons.batch.hunt.hunt:hunt",
        "Search for a run that breaks an expectation, make it as small as possible and save it; exit 1 when found.",
    ),
    "catalogue": Command(
        "Compare and repeat",
        "hil.addons.batch.catalogue_command:catalogue",
        "Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be.",
    ),
    "reproduce": Command(
        "Compare and repeat",
        "hil.addons.batch.reproduction.reproduction:command",
        "Run section IV of the paper and say which of its figures come out, which do not, and why.",
    ),
}
