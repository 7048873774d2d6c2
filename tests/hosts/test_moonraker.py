"""The component in the real Moonraker, in front of the real Klipper host.

MOONRAKER_PYTHON names a Python in which Moonraker is installed, as ``make hosts`` does.
"""

from __future__ import annotations

import base64
import html
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hframe_post.hosts.moonraker.answering import PATIENCE
from hframe_post.hosts.moonraker.interface import PAGE, page_of
from hframe_post.hosts.moonraker.upload import KEPT, Upload
from tests.command_line import RECTANGLE
from tests.conftest import SAMPLES
from tests.hosts.moonraker import Printer, Server, processes, until
from tests.page.pages import data_of

PYTHON = os.environ.get("MOONRAKER_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.klipper,
    pytest.mark.skipif(not PYTHON, reason="MOONRAKER_PYTHON names no Python with Moonraker"),
]

CUBE = (SAMPLES / "cube.gcode").read_bytes()
PART = RECTANGLE.read_bytes()
LIMIT_EXCEEDED = r"line \d+: belt velocity \(mm/s\) would be \d+\S*, the .* limit is 20"
KEPT_ENDINGS = (".original", ".html")
OUTSIDE = CUBE + b"G1 X9000 Y10 F6000\n"


@pytest.fixture(scope="module")
def printer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Printer]:
    built = Printer(Path(PYTHON), tmp_path_factory.mktemp("moonraker"))
    try:
        built.start_klipper()
        built.start_moonraker()
        until(lambda: built.get("/server/info")["klippy_state"] == "ready")
        yield built
    finally:
        built.stop()


def test_an_upload_is_converted_described_printed_and_cancelled(printer: Printer) -> None:
    picture = base64.b64encode(b"\x89PNG")
    start = b"; thumbnail begin 32x32 %d\n; %s\n; thumbnail end\n" % (len(picture), picture)
    labels = b"EXCLUDE_OBJECT_DEFINE NAME=cube CENTER=110,110\n"
    sliced = start + CUBE.replace(b";LAYER:0\n", labels + b";LAYER:0\n", 1)
    sliced = sliced.replace(b";LAYER:2\n", b"PAUSE\n;LAYER:2\n", 1)  # until it is cancelled
    answer = printer.upload("cube.gcode", sliced, "/api/files/local", print="true")
    assert answer["print_started"]
    until(lambda: printer.print_stats()["state"] == "paused")
    assert printer.print_stats()["progress"] > 0.01
    printer.post("/printer/print/cancel")
    assert printer.print_stats()["state"] == "cancelled"
    objects = printer.get("/printer/objects/query?exclude_object")["status"]["exclude_object"]
    assert [each["name"] for each in objects["objects"]] == ["CUBE"]
    converted = (printer.gcodes / "cube.gcode").read_bytes()
    assert converted == printer.converted(sliced)
    described = printer.metadata("cube.gcode")
    time = re.search(r"; hframe-post: print time .* → (\d+)m (\d+)s", converted.decode())
    assert time is not None
    assert described["estimated_time"] == pytest.approx(60 * int(time[1]) + int(time[2]), abs=1.0)
    assert described["filament_total"] == pytest.approx(1301.66)  # as the slicer has it
    assert described["file_processors"] == ["hframe_post"]
    assert described["size"] == len(converted)
    row = data_of(printer.request("GET", PAGE, decoded=False))["sections"][-1]["rows"][0]
    assert row[1].startswith("cube.gcode, ")
    assert row[2] == page_of("cube.gcode")
    assert data_of(printer.request("GET", row[2], decoded=False))["name"] == "cube.gcode"
    links = [line for line in printer.console() if f'"{row[2]}"' in line]
    assert len(links) == 2  # when it was converted, and when its print began
    for name in ("../config/printer.toml", ".hframe_post/history", "/etc/passwd", "<b>.gcode"):
        answer = printer.request("GET", page_of(name), decoded=False).decode()
        assert f">{html.escape(name)} has no page" in answer
    assert [thumbnail["size"] for thumbnail in described["thumbnails"]] == [4]
    (summary,) = [line for line in printer.console() if "cube.gcode: converted" in line]
    assert "ringing" in summary


def test_the_same_file_uploaded_again_and_a_converted_one_give_the_same_bytes(
    printer: Printer,
) -> None:
    expected = printer.converted(PART)
    for content in (PART, PART, expected):
        printer.upload("twice.gcode", content)
        assert (printer.gcodes / "twice.gcode").read_bytes() == expected
        assert printer.metadata("twice.gcode")["file_processors"] == ["hframe_post"]
    printer.post("/server/files/metascan?filename=twice.gcode")
    assert (printer.gcodes / "twice.gcode").read_bytes() == expected
    elsewhere = expected.replace(b"settings ", b"settings 0", 1)
    printer.upload("elsewhere.gcode", elsewhere)
    assert (printer.gcodes / "elsewhere.gcode").read_bytes() == elsewhere


def test_a_file_marked_off_stays_as_it_is(printer: Printer) -> None:
    marked = b"; hframe-post: off\n" + PART
    printer.upload("marked.gcode", marked)
    assert (printer.gcodes / "marked.gcode").read_bytes() == marked
    assert any("marked.gcode: the file says" in line for line in printer.console())


def test_what_fails_cannot_be_printed_and_says_why(printer: Printer) -> None:
    printer.upload("fails.gcode", OUTSIDE, print="true")
    until(lambda: printer.print_stats()["state"] == "error")
    assert "not converted: line " in printer.print_stats()["message"]
    assert "9000" in printer.print_stats()["message"]
    refusal, kept = (printer.gcodes / "fails.gcode").read_bytes().split(b"\n", 1)
    assert kept == OUTSIDE
    assert "layer_height" in printer.metadata("fails.gcode")
    entries = printer.get("/server/announcements/list")["entries"]
    assert any("fails.gcode: not converted" in entry["description"] for entry in entries)
    assert any("!! hframe-post: fails.gcode" in line for line in printer.console())
    printer.post("/server/files/metascan?filename=fails.gcode")  # fails again, with one refusal
    assert (printer.gcodes / "fails.gcode").read_bytes() == refusal + b"\n" + OUTSIDE
    printer.upload("fails.gcode", PART, print="true")
    until(lambda: printer.print_stats()["state"] == "complete")
    assert (printer.gcodes / "fails.gcode").read_bytes() == printer.converted(PART)
    assert left_over(printer) == []


@pytest.mark.parametrize("alone", [False, True])
def test_a_conversion_that_was_interrupted_is_done_after_the_restart(
    printer: Printer, alone: bool
) -> None:
    """alone: Moonraker is killed, and the conversion goes on."""
    printer.gate.touch()
    uploading = started(printer, "long.gcode", CUBE)
    path = printer.gcodes / "long.gcode"
    until(lambda: path.exists() and b"not converted yet" in path.read_bytes())
    printer.kill("moonraker", alone)
    uploading.join()
    assert b"not converted yet" in path.read_bytes()
    printer.gate.unlink()
    printer.start_moonraker()
    until(lambda: b"; processed by hframe-post" in path.read_bytes())
    assert path.read_bytes() == printer.converted(CUBE)
    until(lambda: printer.metadata("long.gcode")["size"] == path.stat().st_size)
    until(lambda: left_over(printer) == [])
    path.unlink()


def test_files_with_long_and_similar_names_are_all_converted_after_a_restart(
    printer: Printer,
) -> None:
    names = [*("测" * 70 + f"{each}.gcode" for each in "甲乙"), f"A{'b' * 240}.gcode"]
    names += [f"B{'b' * 240}.gcode", "50%.gcode", "50%25.gcode", "sub/50%.gcode"]
    files = {name: PART + b"; part %d\n" % number for number, name in enumerate(names)}
    printer.kill("moonraker")
    printer.gate.touch()
    for name, content in files.items():
        path = printer.gcodes / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        Upload(path, printer.gcodes).take()  # as a conversion that was interrupted leaves it
    printer.gate.unlink()
    printer.start_moonraker()
    for name, content in files.items():
        path = printer.gcodes / name
        until(lambda path=path: b"; processed by" in path.read_bytes())  # type: ignore[misc]
        assert path.read_bytes() == printer.converted(content), name
    until(lambda: left_over(printer) == [])


def test_an_upload_that_is_deleted_is_not_converted_and_the_next_one_is(printer: Printer) -> None:
    path = printer.gcodes / "long.gcode"
    uploading = started(printer, "long.gcode", 15 * CUBE, print="true")
    until(lambda: len(conversions(printer)) > 0)
    # one at a time: Moonraker confuses uploads that begin in the same second
    waiting = started(printer, "next.gcode", PART)
    printer.request("DELETE", "/server/files/gcodes/long.gcode")
    assert not path.exists()
    waiting.join()
    uploading.join()
    assert (printer.gcodes / "next.gcode").read_bytes() == printer.converted(PART)
    (printer.gcodes / "sub").mkdir(exist_ok=True)
    for name in ("long.gcode", "sub/long.gcode", "long.gcode"):
        printer.upload(name, PART)
        assert (printer.gcodes / name).read_bytes() == printer.converted(PART)
    listed = {each["path"] for each in printer.get("/server/files/list")}
    assert {"long.gcode", "sub/long.gcode", "next.gcode"} <= listed
    assert any("long.gcode: its conversion was stopped" in line for line in printer.console())
    assert printer.print_stats()["state"] not in ("printing", "error")
    assert left_over(printer) == []
    until(lambda: conversions(printer) == [])


def conversions(printer: Printer) -> list[int]:
    return processes(f"{printer.gcodes}/.hframe_post/")


def test_the_reason_of_a_limit_that_a_worker_finds_is_shown(printer: Printer) -> None:
    profile = printer.profile.read_text()
    weak = re.sub("belt_velocity = .*", "belt_velocity = 20.0", profile)
    assert weak != profile
    try:
        printer.profile.write_text(weak)
        printer.upload("weak.gcode", CUBE)
    finally:
        printer.profile.write_text(profile)
    refusal = (printer.gcodes / "weak.gcode").read_text().split("\n")[0]
    assert re.search(rf"not converted: {LIMIT_EXCEEDED}", refusal)
    told = re.compile(rf"!! hframe-post: weak.gcode: not converted: {LIMIT_EXCEEDED}")
    assert any(told.match(line) for line in printer.console())


def test_an_upload_is_answered_before_a_proxy_gives_up_and_goes_on(printer: Printer) -> None:
    printer.gate.touch()
    began = time.monotonic()
    answer = Server.upload(printer, "part.gcode", PART, print="true")
    assert PATIENCE <= time.monotonic() - began < 50.0  # nginx's limit is 60 s
    assert answer["item"]["path"] == "part.gcode"
    assert answer["action"] == "create_file"
    assert not answer["print_started"]
    assert any("part.gcode is still being converted" in line for line in printer.console())
    waiting, other = started(printer, "waits.gcode", PART), printer.gcodes / "waits.gcode"
    waits = "// hframe-post: waits.gcode waits until part.gcode is converted; then it is uploaded"
    until(lambda: any(line.startswith(waits) for line in printer.console()))
    assert not other.exists()
    printer.gate.unlink()
    waiting.join()
    assert other.read_bytes() == printer.converted(PART)
    until(lambda: printer.print_stats()["state"] == "complete")
    assert printer.print_stats()["filename"] == "part.gcode"
    assert (printer.gcodes / "part.gcode").read_bytes() == printer.converted(PART)


def started(printer: Printer, name: str, content: bytes, **form: str) -> threading.Thread:
    """Start an upload that may end with the server."""
    arguments = (printer, name, content)
    uploading = threading.Thread(target=attempted, args=arguments, kwargs=form, daemon=True)
    uploading.start()
    return uploading


def attempted(printer: Printer, name: str, content: bytes, **form: str) -> Any:
    try:
        return printer.upload(name, content, **form)
    except Exception:  # Moonraker is killed meanwhile
        return None


def left_over(printer: Printer) -> list[str]:
    """Return what is in the component's folder but its history, pages and sliced files."""
    names = os.listdir(printer.gcodes / ".hframe_post")
    return [name for name in names if name != "history" and not name.endswith(KEPT_ENDINGS)]


def test_files_of_an_older_model_are_converted_again_whatever_comes_between(
    printer: Printer,
) -> None:
    """A kill in mid-conversion, two uploads at once, names that are no files of Moonraker's."""
    for path in printer.gcodes.glob("*.gcode"):  # of other tests, which would be stale, too
        path.unlink()
    printer.upload("part.gcode", PART)
    path, profile = printer.gcodes / "part.gcode", printer.profile.read_text()
    before = path.read_bytes()
    newer = re.sub("belt_velocity = .*", "belt_velocity = 691.0", profile)
    assert newer != profile
    try:
        printer.profile.write_text(newer)
        assert "part.gcode" in printer.get("/server/hframe_post/status")["stale"]
        printer.gate.touch()
        answer = printer.post("/server/hframe_post/convert?filename=part.gcode")
        assert answer == {"converting": ["part.gcode"]}
        until(lambda: conversions(printer) != [])
        printer.post("/server/hframe_post/cancel")
        until(lambda: conversions(printer) == [])
        assert path.read_bytes() == before
        printer.post("/server/hframe_post/convert?filename=part.gcode")
        until(lambda: conversions(printer) != [])
        printer.kill("moonraker")
        assert path.read_bytes() == before
        printer.gate.unlink()
        printer.start_moonraker()
        until(lambda: printer.get("/server/info")["klippy_state"] == "ready")
        parts = {f"{k}.gcode": PART + b"; %d\n" % k for k in range(2)}
        uploads = [threading.Thread(target=printer.upload, args=each) for each in parts.items()]
        for name, upload in zip(parts, uploads, strict=True):
            upload.start()
            until((printer.gcodes / name).exists)  # within a second, Moonraker confuses them
        printer.post("/server/hframe_post/convert")
        for upload in uploads:
            upload.join()
        until(lambda: printer.get("/server/hframe_post/status")["stale"] == [])
        for name, content in {**parts, "part.gcode": PART}.items():
            assert (printer.gcodes / name).read_bytes() == printer.converted(content), name
        assert path.read_bytes() != before
        for name in ("../config/printer.toml", "/etc/passwd", "none.gcode"):
            with pytest.raises(AssertionError, match="there is no file"):
                printer.post(f"/server/hframe_post/convert?filename={name}")
    finally:
        printer.profile.write_text(profile)
    # by its macro, and before it prints
    printer.type("HFRAME_CONVERT FILENAME=part.gcode")
    until(lambda: path.read_bytes() == printer.converted(PART))
    printer.post("/printer/print/start?filename=0.gcode")
    until(lambda: printer.print_stats()["state"] == "complete")
    assert (printer.gcodes / "0.gcode").read_bytes() == printer.converted(parts["0.gcode"])
    printer.request("DELETE", "/server/files/gcodes/0.gcode")
    kept = printer.gcodes / ".hframe_post"
    count = len([*kept.glob("*.original")])
    assert len([*kept.glob("*.html")]) == count
    until(lambda: len([*kept.glob("*.original")]) < count)
    until(lambda: len([*kept.glob("*.html")]) < count)


@pytest.mark.parametrize(("room", "fits_twice"), [("1600k", True), ("600k", False)])
def test_a_full_disk_leaves_nothing_that_could_be_printed(
    tmp_path: Path, room: str, fits_twice: bool
) -> None:
    if (
        shutil.which("unshare") is None
        or subprocess.run(
            ["unshare", "-rm", "mount", "-t", "tmpfs", "none", tmp_path], check=False
        ).returncode
    ):
        pytest.skip("no disk can be mounted here")
    printer = Printer(Path(PYTHON), tmp_path / "printer")
    mounted = f'mount -t tmpfs -o size={room} none {printer.gcodes} && exec "$@"'
    try:
        printer.start_moonraker("unshare", "-rm", "sh", "-c", mounted, "sh")
        printer.upload("cube.gcode", CUBE)
        left = printer.request("GET", "/server/files/gcodes/cube.gcode", decoded=False)
        refusal, rest = left.split(b"\n", 1)
        assert refusal.startswith(b'RESTORE_GCODE_STATE NAME="hframe-post: not converted')
        assert b"No space left" in refusal
        assert rest == CUBE if fits_twice else rest.startswith(KEPT)
    finally:
        printer.stop()


def test_removing_it_leaves_moonraker_as_it_was(printer: Printer) -> None:
    before = printer.as_set_up
    printer.config.write_text(before)
    assert "[hframe_post]" in before
    assert printer.set_up("--moonraker").count("added") == 0
    assert printer.config.read_text() == before
    assert "removed" in printer.set_up("--no-moonraker")
    assert "hframe_post" not in printer.config.read_text()
    assert not (printer.components / "hframe_post").is_symlink()
    printer.set_up("--moonraker")
    assert printer.config.read_text() == before
