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
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hframe_post.hosts.moonraker.conversion import page_of
from hframe_post.hosts.moonraker.originals import KEPT
from tests.command_line import RECTANGLE
from tests.conftest import SAMPLES
from tests.hosts.moonraker import Printer, processes, until
from tests.page.pages import data_of

PYTHON = os.environ.get("MOONRAKER_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.klipper,
    pytest.mark.skipif(not PYTHON, reason="MOONRAKER_PYTHON names no Python with Moonraker"),
]

CUBE = (SAMPLES / "cube.gcode").read_bytes()
PART = RECTANGLE.read_bytes()
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
    time = re.search(
        r"; hframe-post: print time +(\d+)m (\d+)s → (\d+)m (\d+)s", converted.decode()
    )
    assert time is not None
    m, s, after_m, after_s = map(int, time.groups())
    by_slicer = int(re.findall(rb";TIME:(\d+)", sliced)[0])
    expected = by_slicer + 60 * (after_m - m) + after_s - s
    assert described["estimated_time"] == pytest.approx(expected, abs=1.5)
    assert described["filament_total"] == pytest.approx(1301.66)  # as the slicer has it
    assert described["file_processors"] == ["hframe_post"]
    assert described["size"] == len(converted)
    page = page_of("cube.gcode")
    assert data_of(printer.request("GET", page, decoded=False))["name"] == "cube.gcode"
    links = [line for line in printer.console() if f'"{page}"' in line]
    assert len(links) == 2  # when it was converted, and when its print began
    for name in ("../config/printer.toml", "/etc/passwd", "<b>.gcode"):
        answer = printer.request("GET", page_of(name), decoded=False).decode()
        assert f">{html.escape(name)} has no page" in answer
    assert [thumbnail["size"] for thumbnail in described["thumbnails"]] == [4]
    (summary,) = [line for line in printer.console() if "cube.gcode: converted" in line]
    assert "ringing" in summary


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
    """Return what is in the component's folder but pages and sliced files."""
    names = os.listdir(printer.gcodes / ".hframe_post")
    return [name for name in names if not name.endswith(KEPT_ENDINGS)]


def test_files_of_an_older_model_are_converted_again_whatever_comes_between(
    printer: Printer,
) -> None:
    """A kill in mid-conversion, two uploads at once, names that are not files of Moonraker's."""
    for path in printer.gcodes.glob("*.gcode"):  # of other tests, which would be stale, too
        path.unlink()
    printer.upload("part.gcode", PART)
    path, profile = printer.gcodes / "part.gcode", printer.profile.read_text()
    before = path.read_bytes()
    newer = profile + "x_c = 141.0\n"
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
