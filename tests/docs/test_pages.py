"""What the pages name is there: the targets of links, files, targets of make, commands of hil and their options."""

import itertools
import json
import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from typer.main import get_group

from hil.addons.batch.campaign.campaign_file import load_plan
from hil.addons.batch.hunt.hunt import Hunt, Request
from hil.addons.verify.catalogue import read_catalogue
from hil.cli.commands import shipped
from hil.cli.main import app
from hil.scenario.load import load
from tests.support.processes import ROOT
from tools.page_blocks import REASONS, RUN, Block, blocks

OUTSIDE = {"build", "dist", "node_modules", "runs"}


def is_ours(page: Path) -> bool:
    """Whether a page is none of what tools leave behind."""
    return not any(part in OUTSIDE or part.startswith(".") for part in page.relative_to(ROOT).parts)


PAGES = sorted(filter(is_ours, ROOT.rglob("*.md")))
GUIDES = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "docs/tour.md", "docs/proven.md")]
EXTENDS = 'extends = "paper_circle"\n'
GROUPS = {f"hil.{kind}" for kind in ("laws", "references", "drivers", "links", "faults", "commands")}
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
    shown = "\n".join([*(block.text for block in blocks(text)), *re.findall(r"`[^`\n]+`", text)])
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"(?:^ *|`)make ([a-z-]+)", shown, re.MULTILINE)) <= targets
    assert set(re.findall(r"(?:^ *|`)hil ([a-z0-9]+)", shown, re.MULTILINE)) <= shipped().keys()


def test_the_tour_names_every_command() -> None:
    text = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")
    assert [name for name in shipped() if f"hil {name}" not in text] == []


def typed(page: Path) -> Iterator[str]:
    """Yield the commands of hil that a page shows."""
    for block in blocks(page.read_text(encoding="utf-8")):
        if block.language not in RUN:
            continue
        yield from re.findall(r"^(?:\$ )?(hil .*)$", block.text.replace("\\\n", " "), re.MULTILINE)


PROGRAM = get_group(app)
PLACEHOLDER = re.compile(r"[A-Z_]+|…|\.\.\.")  # what a page writes for any command


def words_of(line: str) -> list[str]:
    """Return the words of a command of the shell, up to a pipe, a redirection or another command."""
    split = shlex.shlex(line, posix=True, punctuation_chars=True)
    split.whitespace_split = True
    return list(itertools.takewhile(lambda word: word[0] not in "|&;<>()", split))


def problem(words: list[str]) -> str | None:
    """Return the command line's error for these arguments: an unknown command or option; None for none of these."""
    context = typer.Context(PROGRAM, info_name="hil")
    command: Any = PROGRAM
    while words and hasattr(command, "get_command"):
        if words[0].startswith("-"):
            words = words[1:]
            continue
        name, *others = words
        below = command.get_command(context, name)
        if below is not None:
            words = others
        elif (below := command.get_command(context, "run")) is None or command is PROGRAM:  # of hil campaign
            return f"no command {name!r}"
        command, context = below, typer.Context(below, parent=context, info_name=name)
    known = {one for option in command.params for one in (*option.opts, *option.secondary_opts)} | {"-h", "--help"}
    unknown = [word for word in words if word.startswith("--") and word.partition("=")[0] not in known]
    return f"no option {unknown[0]!r} of {context.command_path!r}" if unknown else None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_every_page_exist_with_their_options(page: Path) -> None:
    wrong = []
    for line in typed(page):
        words = words_of(line)[1:]
        if words and not PLACEHOLDER.fullmatch(words[0]) and (found := problem(words)) is not None:
            wrong.append(f"{line}: {found}")
    assert wrong == []


def read_toml(block: Block, folder: Path) -> None:
    """Read a block as what it is for would: a campaign, a hunt, mutants, an entry point, or a scenario."""
    tables = tomllib.loads(block.text)
    file = folder / block.options.get("caption", "block.toml")
    file.parent.mkdir(exist_ok=True)
    file.write_text(block.text, encoding="utf-8")
    if "axes" in tables:
        load_plan(file)
    elif "range" in tables:
        assert Hunt(Request("circle_speed", file)).next_jobs([], 1)
    elif "mutant" in tables:
        known = {entry.mutant.id for entry in read_catalogue().mutants}
        assert {f"{tables['room']}.{row['id']}" for row in tables["mutant"]} <= known
    elif "project" in tables:
        assert tables["project"]["entry-points"].keys() <= GROUPS
    elif block.word != "form":
        file.write_text(block.text if "extends" in tables else EXTENDS + block.text, encoding="utf-8")
        load(file)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_of_every_page_can_be_read(page: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "hil" / "addons" / "motors" / "dbc" / "examples", tmp_path, dirs_exist_ok=True)
    for block in blocks(page.read_text(encoding="utf-8")):
        if block.language == "toml":
            read_toml(block, tmp_path)
        elif block.language == "python":
            compile(block.text, f"{page.name}, line {block.line}", "exec")
        elif block.language == "json":
            [json.loads(line) for line in block.text.splitlines()]
        elif block.language == "yaml":
            assert yaml.safe_load(block.text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_block_says_what_it_is_and_why_it_is_not_run(page: Path) -> None:
    for block in blocks(page.read_text(encoding="utf-8")):
        assert block.language in (*RUN, "toml", "json", "yaml", "c", "text", "{toctree}", "{eval-rst}"), (
            f"{page}, line {block.line}"
        )
        assert block.language not in RUN or block.word in ("", *REASONS), f"{page}, line {block.line}"


def test_what_is_not_run_is_counted() -> None:
    words = [one.word for page in PAGES for one in blocks(page.read_text(encoding="utf-8")) if one.language in RUN]
    rows = [f"| {words.count(word)} | {why} |" for word, why in {"": "run by the tests", **REASONS}.items()]
    assert "\n".join(rows) in (ROOT / "docs" / "proven.md").read_text(encoding="utf-8")
