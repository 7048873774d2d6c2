"""What Moonraker's component runs for each file, without Moonraker: the file and its place."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from hframe_post.hosts import moonraker
from hframe_post.hosts.moonraker import conversion
from hframe_post.hosts.moonraker.conversion import Interface, Settings, as_html, page_of
from hframe_post.hosts.moonraker.disk import FOLDER, BeyondError, FailureError, alone
from hframe_post.hosts.moonraker.originals import CONVERTING, REFUSAL, Originals, Upload, refuse
from tests.command_line import RECTANGLE, run
from tests.conftest import ROOT
from tests.hosts.moonraker import WAIT, until, waiting_for

COMMAND = (sys.executable, "-m", "hframe_post", "-p", str(ROOT / "tests/measured.toml"))
PART = RECTANGLE.read_bytes()
OUTSIDE = PART + b'G1 X9000 Y10 F6000 <b> ; "far" away\n'


@pytest.fixture
def part(tmp_path: Path) -> Path:
    (tmp_path / FOLDER).mkdir()
    (tmp_path / "sub").mkdir()
    path = tmp_path / "sub" / "part.gcode"
    path.write_bytes(PART)
    return path


def kept(part: Path) -> list[str]:
    return sorted(os.listdir(part.parents[1] / FOLDER))


KEPT = [".html", ".original"]  # of each converted file


def endings(part: Path) -> list[str]:
    return sorted(Path(name).suffix for name in kept(part))


def started(part: Path, *command: str) -> subprocess.Popen[bytes]:
    """Start the component as a program on a file."""
    gcodes = next(folder for folder in part.parents if (folder / FOLDER).is_dir())
    return begun("upload", settings(gcodes, *command), part)


def settings(
    gcodes: Path, *command: str, keep: int = 10_000_000, recordings: str = "/nowhere"
) -> Settings:
    address = str(gcodes / "socket")
    return Settings(str(gcodes), address, [*(command or COMMAND)], keep, recordings)


def begun(duty: str, told: Settings, *words: str | Path) -> subprocess.Popen[bytes]:
    """Start a duty of the component."""
    return subprocess.Popen(words_of(duty, told, *words), cwd=ROOT)


def words_of(duty: str, told: Settings, *words: str | Path) -> list[str]:
    folder = Path(moonraker.__file__).parent
    return [str(word) for word in (sys.executable, folder, duty, told.as_json(), *words)]


def stale(told: Settings) -> Any:
    return json.loads(subprocess.check_output(words_of("stale", told), cwd=ROOT))


def processed(part: Path, *command: str) -> int:
    """Run the component as a program on a file; return its exit status."""
    return started(part, *command).wait()


@pytest.fixture
def reports(part: Path) -> Iterator[list[Any]]:
    """What a listener at Moonraker's place receives."""
    received: list[Any] = []
    with closing(socket.socket(socket.AF_UNIX)) as listening:
        listening.bind(str(part.parents[1] / "socket"))
        listening.listen()

        def answer() -> None:
            while True:
                try:
                    connection = listening.accept()[0]
                except OSError:  # shut down below
                    return
                with connection:
                    report = json.loads(connection.recv(1 << 16).rstrip(b"\x03"))["params"]
                    if "being converted" not in report["text"]:  # as on a busy machine
                        received.append(report)
                    connection.sendall(b"{}\x03")

        answering = threading.Thread(target=answer)
        answering.start()
        yield received
        listening.shutdown(socket.SHUT_RDWR)
        answering.join()


@pytest.mark.slow
def test_a_file_that_fails_begins_with_its_reason_until_it_can_be_converted(
    part: Path, reports: list[Any]
) -> None:
    part.write_bytes(OUTSIDE)
    for _ in range(2):
        assert processed(part) == 1
        refusal, rest = part.read_bytes().split(b"\n", 1)
        assert refusal.startswith(REFUSAL.encode() + b"not converted: line ")
        assert refusal.count(b'"') == 2
        assert b"<" not in refusal  # Klipper's console shows it
        assert rest == OUTSIDE
        assert kept(part) == []
    assert all(each["failed"] for each in reports)
    part.write_bytes(part.read_bytes().replace(OUTSIDE, PART))
    assert processed(part) == 0
    assert b"; processed by hframe-post" in part.read_bytes()


def test_a_console_shows_names_as_they_are_and_links_pages() -> None:
    name = "<img src=x onerror=run()> & _G28 PAUSE.gcode"
    shown = as_html(f"{name}: {page_of(name)}")
    assert shown.startswith("&lt;img src=x onerror=run()&gt; &amp; _G28 PAUSE.gcode: <a href=")
    (address,) = re.findall('href="([^"]*)"', shown)
    assert parse_qs(urlsplit(address).query) == {"file": [name]}
    assert not re.search("[A-Z_][A-Z0-9_.]", address)  # what Fluidd takes for a command


def test_a_conversion_that_takes_too_long_is_ended(
    part: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = tmp_path / "gate"
    gate.touch()
    monkeypatch.setattr(conversion, "MAX_HOURS", 0.5 / 3600.0)
    words, target = [*waiting_for(gate), *COMMAND], tmp_path / "target"
    with pytest.raises(BeyondError, match="takes more than"):
        conversion.converted(
            part, target, part.name, words, Interface("nowhere"), lambda: False, True
        )
    assert not target.exists()


OTHER = ("--tolerance", "0.008")  # an option that changes the output, as another profile does


def converted_by(options: tuple[str, ...], folder: Path) -> bytes:
    (folder / "in.gcode").write_bytes(PART)
    done = run(folder / "in.gcode", "-o", "-", "-p", ROOT / "tests/measured.toml", *options)
    return done.stdout


@pytest.mark.slow
def test_a_converted_file_is_converted_again_whatever_became_of_its_name(
    part: Path, reports: list[Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    gcodes, newer = part.parents[1], settings(part.parents[1], *COMMAND, *OTHER)
    assert processed(part) == 0
    renamed = gcodes / "renamed.gcode"
    part.rename(renamed)
    by_hand = gcodes / "by_hand.gcode"  # converted elsewhere: nothing of it is kept
    by_hand.write_bytes(renamed.read_bytes() + b"; another\n")
    before = by_hand.read_bytes()
    assert stale(settings(gcodes)) == {"old": [], "kept": []}
    assert stale(newer)["kept"] == ["renamed.gcode"]
    for words in ((), ("renamed.gcode",)):
        assert begun("again", newer, *words).wait() == 0
        assert renamed.read_bytes() == converted_by(OTHER, tmp_path_factory.mktemp("by_hand"))
        assert endings(part) == KEPT
    assert begun("again", newer, "by_hand.gcode").wait() == 1
    assert by_hand.read_bytes() == before
    assert reports[-1]["text"].endswith("its sliced file is not kept: upload it again")
    # what fails or is killed leaves the file as it is
    before, held = renamed.read_bytes(), kept(part)
    assert begun("again", settings(gcodes, *COMMAND, "--jobs", "0"), "renamed.gcode").wait() == 1
    assert "renamed.gcode: left as it was converted before: " in reports[-1]["text"]
    with begun("again", settings(gcodes), "renamed.gcode") as killed:
        killed.kill()
    assert begun("tidy", newer).wait() == 0
    assert (renamed.read_bytes(), kept(part)) == (before, held)
    renamed.unlink()
    assert begun("tidy", newer).wait() == 0
    assert kept(part) == []


@pytest.mark.slow
def test_no_more_is_kept_than_the_owner_allows(part: Path, reports: list[Any]) -> None:
    gcodes, room = part.parents[1], 3 * len(PART) // 2
    paths = [part, part.with_name("second.gcode")]
    for path in paths:
        path.write_bytes(PART)
        assert begun("upload", settings(gcodes, keep=room), path).wait() == 0
    originals = Originals(gcodes, room)
    assert [originals.of(path).exists() for path in paths] == [False, True]
    assert endings(part) == [".original"]  # a page is larger than the room, and goes first
    assert begun("again", settings(gcodes, keep=0), "sub/second.gcode").wait() == 0
    assert kept(part) == []
    assert all(b"; processed by" in path.read_bytes() for path in paths)


@pytest.mark.slow
def test_an_interrupted_conversion_goes_on_from_the_slicers_file(part: Path) -> None:
    upload = Upload(part, part.parents[1])
    upload.take()
    refusal, name, end = part.read_text().split("\n")
    assert refusal == f'{REFUSAL}{CONVERTING}"'
    assert name == f"; hframe-post keeps the sliced file as {upload.work.name}"
    assert end == ""
    assert upload.work.read_bytes() == PART
    assert processed(part) == 0
    assert b"; processed by hframe-post" in part.read_bytes()
    upload.refuse(CONVERTING)  # as if it were interrupted once more, and the original deleted
    with pytest.raises(FailureError, match="upload it again"):
        upload.take()


LONG = "é" * 117  # 234 bytes of at most 255 in a name
NAMES = [
    f"1{LONG}.gcode", f"2{LONG}.gcode", "测" * 80 + ".gcode", "试" + "测" * 79 + ".gcode",
    "🖨" * 60 + ".gcode", "🧊" + "🖨" * 59 + ".gcode", "Part.gcode", "part.gcode", "50%.gcode",
    "50%25.gcode", "sub%2Fpart.gcode", "sub/part.gcode", "a/" + LONG + ".gcode",
    "b/" + LONG + ".gcode", "sub/sub/part.gcode", "-dash.gcode", "two words.gcode",
]  # fmt: skip


def test_after_an_interruption_every_name_gets_its_own_file_back(tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    uploads = []
    for number, name in enumerate(NAMES):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(PART + b"; part %d\n" % number)
        uploads.append(Upload(path, tmp_path))
        uploads[-1].take()
    assert len(os.listdir(tmp_path / FOLDER)) == len(NAMES)
    for number, name in reversed([*enumerate(NAMES)]):
        again = Upload(tmp_path / name, tmp_path)
        again.take()
        assert again.work.read_bytes() == PART + b"; part %d\n" % number, name
        again.give_back(None, Originals(tmp_path, 0))
    assert os.listdir(tmp_path / FOLDER) == []


def test_a_line_that_names_any_other_file_is_not_followed(part: Path) -> None:
    part.with_name("secret.sliced").write_bytes(b"G28\n")
    line = f'{REFUSAL}x"\n; hframe-post keeps the sliced file as ../sub/secret.sliced\n'
    part.write_text(line)
    upload = Upload(part, part.parents[1])
    upload.take()
    assert upload.work.read_text() == line.split("\n", 1)[1]
    assert part.with_name("secret.sliced").read_bytes() == b"G28\n"


@pytest.mark.parametrize(
    "fate",
    [
        "deleted",
        *(pytest.param(fate, marks=pytest.mark.slow) for fate in ("renamed", "written over")),
    ],
)
def test_a_conversion_ends_when_its_file_is_gone(
    part: Path, reports: list[Any], fate: str, tmp_path: Path
) -> None:
    renamed, began = part.with_name("new.gcode"), tmp_path / "began"
    # at first a command that never ends by itself, as that of a long file
    command = ("sh", "-c", f'test -e {began} && exec "$@"; touch {began}; read x', "sh", *COMMAND)
    with started(part, *command) as program:
        try:
            until(began.exists)
            if fate == "deleted":
                part.unlink()
            elif fate == "renamed":
                part.rename(renamed)
            else:
                part.write_bytes(PART)
            status = program.wait(timeout=WAIT)
        finally:
            program.kill()
    if fate == "written over":
        assert status == 0
        assert b"; processed by hframe-post" in part.read_bytes()
    else:
        assert status == 1
        assert not part.exists()
        texts = [each["text"] for each in reports]
        assert texts == [
            f"hframe-post: part.gcode: its conversion was stopped, because it was {fate}"
        ]
    if fate == "renamed":
        assert processed(renamed) == 0
        assert b"; processed by hframe-post" in renamed.read_bytes()
    assert endings(part) == ([] if fate == "deleted" else KEPT)


def test_a_file_that_is_deleted_while_it_waits_is_no_failure(
    part: Path, reports: list[Any]
) -> None:
    with alone(part.parents[1] / FOLDER):
        program = started(part)
        part.unlink()
    assert program.wait(timeout=WAIT) == 1
    assert reports == []
    assert kept(part) == []


def test_without_room_for_a_line_the_file_is_out_of_reach_but_not_lost(
    part: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload = Upload(part, part.parents[1])
    monkeypatch.setattr(Upload, "refuse", full)
    with pytest.raises(OSError, match="No space"):
        upload.take()
    refuse(upload, "the disk is full")
    assert not part.exists()
    assert upload.work.read_bytes() == PART


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
