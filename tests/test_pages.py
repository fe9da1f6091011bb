"""What the pages name is there: the targets of links, files, targets of make and commands of hil."""

import re
from pathlib import Path

import pytest

from hil.cli.commands import SHIPPED
from tests.processes import ROOT

OUTSIDE = {"build", "dist", "node_modules", "runs"}


def is_ours(page: Path) -> bool:
    """Whether a page is none of what tools leave behind."""
    return not any(part in OUTSIDE or part.startswith(".") for part in page.relative_to(ROOT).parts)


PAGES = sorted(filter(is_ours, ROOT.rglob("*.md")))
GUIDES = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")]
# Rooms of ours in backticks. NAME stands for one's own; a file that is built is not in a fresh checkout.
OURS = re.compile(r"`((?:hil|plant_fmu|firmware_protocol|tools|tests|docs)/[\w./-]*)`")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"\w+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_files_named_in_the_guides_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = [path for path in OURS.findall(text) if "NAME" not in path and not (ROOT / path).exists()]
    assert missing == []


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_commands_named_in_the_guides_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    shown = "\n".join(re.findall(r"^    .*$|`[^`\n]+`", text, re.MULTILINE))
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"(?:^ *|`)make ([a-z-]+)", shown, re.MULTILINE)) <= targets
    assert set(re.findall(r"(?:^ *|`)hil ([a-z0-9]+)", shown, re.MULTILINE)) <= SHIPPED.keys()


def test_the_readme_names_every_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [name for name in SHIPPED if f"hil {name}" not in text] == []
