"""The documentation is correct: snippets run, links have targets, names exist."""

import re
import shutil
import tomllib
import unicodedata
from pathlib import Path

import click
import pytest

from hframe_post.cli.main import COMMANDS, main
from hframe_post.identification.recordings.formats import command_csv
from hframe_post.identification.recordings.strokes import runs
from hframe_post.printer.profile import load
from tests.conftest import ROOT, SAMPLES
from tests.recordings import write_klipper
from tests.simulator import Axis, Chip, Machine, Mode
from tools import site

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
EVERY_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    """Return a page without its fenced blocks."""
    return FENCED.sub("", page.read_text("utf-8"))


SNIPPETS = {
    page: [code for kind, code in FENCED.findall(page.read_text("utf-8")) if kind == "python"]
    for page in PAGES
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the files that snippets read: a print, and strokes of a printer with recordings."""
    folder = tmp_path_factory.mktemp("snippets")
    shutil.copy(SAMPLES / "rectangle.gcode", folder / "in.gcode")
    (folder / "sample_gcode").symlink_to(SAMPLES)
    axes = Axis((Mode(30.0, 0.05),), 1e-3), Axis((Mode(40.0, 0.08),), 1e-3)
    machine, chip = Machine(*axes, racking=2e-8), Chip(noise=0.1)
    held = folder / "recordings"
    held.mkdir()
    for seed, run in enumerate(runs(load("paper"), seconds=15.0)):
        (held / f"m.{run.name}.csv").write_bytes(b"".join(command_csv(run.command)))
        recording = chip.record(machine, run.command, seed)
        write_klipper(held / f"adxl345-{run.name}.csv", recording)
    return folder


LONG = "interfaces.md"  # it converts, simulates, tunes and identifies


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] * (page.name == LONG), id=page.name)
        for page in PAGES
        if SNIPPETS[page]
    ],
)
def test_snippets_run(page: Path, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All snippets of a page share a namespace, as in a reader's session."""
    monkeypatch.chdir(files)
    names: dict[str, object] = {"__name__": page.name}
    for code in SNIPPETS[page]:
        exec(compile(code, f"{page.name}: {code.splitlines()[0]}", "exec"), names)


def test_snippets_are_there_and_can_fail(files: Path) -> None:
    assert SNIPPETS[ROOT / "docs" / "interfaces.md"]
    with pytest.raises(AttributeError):
        exec("import hframe_post as hp\nhp.compensat", {})


LINK = re.compile(r"\]\((?!https?:)([^)\s#]*)(?:#([^)\s]+))?\)")


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives a page's headings."""
    return {
        re.sub(r"[^\w\- ]", "", unicodedata.normalize("NFC", heading).lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ +(.+?) *$", prose(page), re.MULTILINE)
    }


def broken(page: Path) -> list[str]:
    """Return the links of a page without a target."""
    lost = []
    for target, anchor in LINK.findall(prose(page)):
        to = page.parent / target if target else page
        if not to.exists() or (anchor and (to.suffix != ".md" or anchor not in anchors(to))):
            lost.append(f"{target}#{anchor}")
    return lost


@EVERY_PAGE
def test_links_have_targets(page: Path) -> None:
    assert not broken(page)


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# What is µ?\n[a](#what-is-µ) [b](#b) [c](page.md#c) [d](none.md)\n")
    assert broken(page) == ["#b", "page.md#c", "none.md#"]


@EVERY_PAGE
def test_pages_can_be_reached(page: Path) -> None:
    """From the README, by any number of links."""
    reached, new = set[Path](), {ROOT / "README.md"}
    while new:
        reached |= new
        new = {
            (one.parent / target).resolve()
            for one in new
            for target, _ in LINK.findall(prose(one))
            if target.endswith(".md")
        } - reached
    assert page.resolve() in {one.resolve() for one in reached}


CODE_PATH = re.compile(r"`((?:[\w.-]+/)*[\w.-]+\.(?:py|toml|gcode|md|cfg)|[\w./-]+/)`")
MEMBER = re.compile(r"`(\w+)\.(?!py|toml|md|csv|gcode|npz)(\w+)[`(\[]")
TYPE = re.compile(r"`([A-Z][a-z]+[A-Z]?\w*)`")
SOURCES = {path: path.read_text("utf-8") for path in (ROOT / "hframe_post").rglob("*.py")}
HOUSE = pytest.mark.parametrize(
    "name", ["architecture.md", "derivations.md", "interfaces.md", "../CONTRIBUTING.md"]
)


def known_path(name: str) -> bool:
    """Return whether a path named in the text exists in the tree."""
    bases = (ROOT, ROOT / "hframe_post", ROOT / "docs", SAMPLES)
    return "NAME" in name or any((base / name).exists() for base in bases)


def defines(owner: str, member: str) -> bool:
    """Return whether the module or class of that name, if there is one, has such a member."""
    homes = [text for path, text in SOURCES.items() if path.stem == owner]
    homes += [text for text in SOURCES.values() if re.search(rf"^class {owner}\b", text, re.M)]
    named = rf"^ *(?:class|def) {member}\b|^ *{member}\b *[:=,]"
    return not homes or any(re.search(named, text, re.M) for text in homes)


@HOUSE
def test_files_and_rooms_named_exist(name: str) -> None:
    """Paths in backticks: ``planner/lookahead.py``, ``gcode/``; NAME stands for any."""
    named = CODE_PATH.findall(prose(ROOT / "docs" / name))
    assert not [path for path in named if not known_path(path)]


@HOUSE
def test_members_and_types_named_exist(name: str) -> None:
    """``lpfbs.bsplines``, ``Window.n_C``, ``Filter``."""
    text = prose(ROOT / "docs" / name)
    assert not [f"{one}.{two}" for one, two in MEMBER.findall(text) if not defines(one, two)]
    source = "\n".join(SOURCES.values())
    types = {one for one in TYPE.findall(text) if not re.search(rf"^class {one}\b", source, re.M)}
    assert types <= {"Gxx", "Gyy", "Gxtheta", "None"}


QUOTED = re.compile(r"\*([^*]+)\*")
JOINT = re.compile(r'"\s*\n\s*f?"')


def test_messages_shown_are_those_of_the_tool() -> None:
    """The messages in the first column, as far as they do not vary."""
    macros = [path.read_text("utf-8") for path in (ROOT / "hframe_post").rglob("*.cfg.in")]
    source = JOINT.sub("", "\n".join([*SOURCES.values(), *macros]))
    rows = re.findall(r"^\| ([^|]*\*[^|]*) \|", prose(ROOT / "docs" / "start.md"), re.MULTILINE)
    pieces = [
        piece.strip(" .,")
        for row in rows
        for quoted in QUOTED.findall(row)
        for piece in re.split(r"…|\b\d+\b", quoted)
    ]
    assert len(pieces) > 10
    assert not [piece for piece in pieces if piece not in source]


def test_names_that_are_gone_are_found() -> None:
    assert not known_path("gcode/words.py")
    assert not defines("lpfbs", "bspline")
    assert not defines("Window", "n_D")
    assert defines("Window", "n_C")


def test_layers_shown_are_those_of_the_contract() -> None:
    shown = FENCED.findall((ROOT / "docs" / "architecture.md").read_text("utf-8"))
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    layers = contract["tool"]["importlinter"]["contracts"][0]["layers"]
    assert "\n".join(layers) + "\n" in [text for _, text in shown]


CALL = re.compile(r"hframe-post ([^#`\n|]*)")


@EVERY_PAGE
def test_commands_shown_are_those_of_the_tool(page: Path) -> None:
    """Each option of each command line, looked up among that command's parameters."""
    for line in CALL.findall(page.read_text("utf-8").replace("\\\n", "")):
        words = line.split()
        names = [word for word in words if not word.startswith("-")]
        name = names[0] if names and names[0] in COMMANDS else "convert"
        chosen = main.get_command(click.Context(main), name)
        assert chosen is not None
        if isinstance(chosen, click.Group):
            continue
        options = [(*each.opts, *each.secondary_opts) for each in chosen.params]
        known = {option for names in options for option in names}
        for word in words:
            if word.startswith("-") and word not in ("-", "--help", "-h", "--version"):
                assert word in known, f"{page.name}: {line}"


def test_pages_made_from_the_code_have_all_keys_and_options() -> None:
    keys, options = site.keys(), site.options()
    rows = set(re.findall(r"^\| `(\w+)` \|", keys, re.MULTILINE))
    assert {"belt_acceleration", "effort", "junction_deviation", "max_error"} <= rows
    assert "| `n_C` | `int` | > 0, ≤ 1000 | `88` |" in keys
    assert all(f"\n## {name}\n" in options for name in COMMANDS)
    assert "--max-error" in options
