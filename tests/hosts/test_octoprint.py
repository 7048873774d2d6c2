"""The plugin in the real OctoPrint.

OCTOPRINT_PYTHON names a Python in which OctoPrint is installed, as ``make hosts`` does.
"""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.chromium import PROGRAM, Browser
from tests.command_line import RECTANGLE, run
from tests.conftest import ROOT, SAMPLES
from tests.hosts.moonraker import Server, free_port, processes, until, waiting_for

PYTHON = os.environ.get("OCTOPRINT_PYTHON", "")
needs_octoprint = pytest.mark.skipif(
    not PYTHON, reason="OCTOPRINT_PYTHON names no Python with OctoPrint"
)
slow = pytest.mark.slow
PROFILE = ROOT / "tests/measured.toml"
PART = RECTANGLE.read_bytes()
CUBE = (SAMPLES / "cube.gcode").read_bytes()
KEY = "0123456789ABCDEF0123456789ABCDEF"
CONFIG = f"""\
server: {{firstRun: false, onlineCheck: {{enabled: false}}, pluginBlacklist: {{enabled: false}}}}
api: {{key: {KEY}}}
accessControl: {{salt: abc}}
plugins: {{_disabled: [tracking, softwareupdate, announcements, discovery, pluginmanager]}}
"""
SECRET = hashlib.sha512(b"me" + b"abc").hexdigest()  # the user's password and the salt
USER = f"""\
me: {{active: true, apikey: null, groups: [admins], password: {SECRET}, permissions: [], roles: []}}
"""


def test_the_plugin_is_installed_for_a_measured_printer(tmp_path: Path) -> None:
    done = run("connect", "octoprint", "-p", PROFILE, "--folder", tmp_path)
    plugin = (tmp_path / "plugins/hframe_post/__init__.py").read_text()
    assert done.stdout.decode().startswith(f"{tmp_path}/plugins/hframe_post\n")
    assert f"PROFILE = '{PROFILE}'\n" in plugin
    refused = run("connect", "octoprint", "-p", "paper", "--folder", tmp_path)
    assert refused.returncode == 1
    assert b"not measured" in refused.stderr
    marlin = tmp_path / "marlin.toml"
    text = 'extends = "paper-marlin"\nplant.invented = false\nfirmware.marlin.baud = '
    marlin.write_text(f"{text}0\n")
    for_sd = run("connect", "octoprint", "-p", marlin, "--folder", tmp_path)
    assert for_sd.returncode == 1
    assert b"firmware.marlin.baud: OctoPrint prints over a serial line" in for_sd.stderr
    missing = run("connect", "octoprint", "-p", PROFILE, HOME=str(tmp_path))
    assert b".octoprint does not exist" in missing.stderr
    assert (tmp_path / "plugins/hframe_post/__init__.py").read_text() == plugin
    marlin.write_text(f"{text}115200\n")
    assert run("connect", "octoprint", "-p", marlin, "--folder", tmp_path).returncode == 0


def test_the_plugin_of_a_package_runs_the_installed_tool(tmp_path: Path) -> None:
    """OctoPrint may be started in the folder of the sources, whose compiled part is not built."""
    plugin = (ROOT / "hframe_post/hosts/octoprint/__init__.py").read_text()
    (words,) = re.findall(r"^COMMAND = (\[.*?\])", plugin, re.MULTILINE)
    fake = tmp_path / "hframe_post" / "__init__.py"
    fake.parent.mkdir()
    fake.write_text("raise ImportError('not the tool')\n")
    command = [*eval(words, {"sys": sys}), "--version"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stdout[:11]) == (0, b"hframe-post"), done.stderr


@pytest.fixture
def octoprint(tmp_path: Path) -> Iterator[Server]:
    (tmp_path / "config.yaml").write_text(CONFIG)
    (tmp_path / "users.yaml").write_text(USER)
    shutil.copy(PROFILE, tmp_path / "printer.toml")
    run("connect", "octoprint", "-p", tmp_path / "printer.toml", "--folder", tmp_path)
    plugin = tmp_path / "plugins/hframe_post/__init__.py"
    waits = ", ".join(map(repr, waiting_for(tmp_path / "gate")))
    plugin.write_text(plugin.read_text().replace("COMMAND = [", f"COMMAND = [{waits}, ", 1))
    server = Server(free_port(), {"X-Api-Key": KEY})
    with (tmp_path / "out").open("wb") as output:
        process = subprocess.Popen(
            [
                PYTHON, "-m", "octoprint", "serve", "--basedir", tmp_path, "--host", "127.0.0.1",
                "--port", str(server.port), "--iknowwhatimdoing",
            ],
            stdout=output, stderr=output, start_new_session=True,
        )  # fmt: skip
    try:
        until(lambda: bool(server.request("GET", "/api/version")))
        yield server
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def settings(octoprint: Server, **values: object) -> None:
    text = json.dumps({"plugins": {"hframe_post": values}})
    octoprint.request("POST", "/api/settings", text.encode(), "application/json")


@slow
@needs_octoprint
@pytest.mark.skipif(PROGRAM is None, reason="there is no chromium")
def test_the_settings_page_and_the_list_of_files(octoprint: Server, tmp_path: Path) -> None:
    """Settings are made in the browser; the list tells what became of each file."""
    uploads, shots = tmp_path / "uploads", Path(os.environ.get("ARTEFACTS", tmp_path)).absolute()
    octoprint.upload("part.gcode", PART, "/api/files/local")
    with Browser(tmp_path / "browser") as browser:
        browser.screen(1400, 1000)
        browser("Page.navigate", url=f"http://127.0.0.1:{octoprint.port}/")
        until(lambda: browser.value("!!document.querySelector('#login-button')"))
        browser.value("void $('#login-user, #login-password').val('me').change().keyup()")
        browser.value("void $('#login-button').click()")
        until(lambda: browser.value("document.querySelectorAll('.hframe-post').length == 1"))
        line = browser.value("document.querySelector('.hframe-post').textContent")
        assert re.match(r"Compensated: ringing.* [\d.]+ → [\d.]+ µm RMS$", line)
        browser.value("void $('#navbar_show_settings').click()")
        until(lambda: browser.value("$('#settings_dialog').is(':visible')"))
        browser.value("void $('#settings_plugin_hframe_post_link a').click()")
        page = "$('#settings_plugin_hframe_post')"
        until(lambda: browser.value(f"{page}.is(':visible')"))
        assert browser.value("$('#hframe_post_profile').val()") == str(tmp_path / "printer.toml")
        browser.value("void $('#hframe_post_refused').val('keep').change()")
        browser.value("void $('#hframe_post_nice').val('3').change()")
        browser.shot(shots / "octoprint-settings.png")
        browser.value("void $('#settings_dialog .btn-primary:visible').click()")
        until(lambda: "refused: keep" in (tmp_path / "config.yaml").read_text())
        octoprint.upload("far.gcode", PART + b"G1 X9000 F6000\n", "/api/files/local")
        stored = (uploads / "far.gcode").read_bytes()
        assert re.match(rb";NOT COMPENSATED: hframe-post failed: line .* 9000", stored)
        assert stored.partition(b"\n")[2] == PART + b"G1 X9000 F6000\n"
        refused = "document.querySelector('.hframe-post.text-error')?.textContent"
        until(lambda: "NOT compensated: line" in (browser.value(refused) or ""))
        browser.value("void $('.modal').modal('hide')")
        time.sleep(1.0)  # dialogs fade
        browser.shot(shots / "octoprint-files.png")
        assert not [each for each in browser.complaints if "hframe" in each]
    settings(octoprint, enabled=False)
    octoprint.upload("part.gcode", PART, "/api/files/local")
    assert (uploads / "part.gcode").read_bytes() == PART


@slow
@needs_octoprint
def test_an_upload_is_converted_or_fails_with_the_reason(octoprint: Server, tmp_path: Path) -> None:
    stored, expected = tmp_path / "uploads/part.gcode", tmp_path / "expected.gcode"
    run(RECTANGLE, "-o", expected, "-p", tmp_path / "printer.toml")
    for content in (PART, expected.read_bytes()):
        octoprint.upload("part.gcode", content, "/api/files/local")
        assert stored.read_bytes() == expected.read_bytes()
    with pytest.raises(AssertionError, match=r"did not convert this file: line .* 9000"):
        octoprint.upload("part.gcode", PART + b"G1 X9000 F6000\n", "/api/files/local")
    assert stored.read_bytes() == expected.read_bytes()  # that of the last upload that succeeded
    octoprint.upload("marked.gcode", b"; hframe-post: off\n" + PART, "/api/files/local")
    assert (tmp_path / "uploads/marked.gcode").read_bytes().endswith(PART)
    shown = logged(tmp_path)
    for text in (
        "INFO - part.gcode: result           ringing",
        "INFO - part.gcode: next             print it",
        "WARNING - part.gcode: WARNING          not converted: line ",
        "INFO - marked.gcode: the file says",
    ):
        assert any(text in line for line in shown), (text, shown)


def logged(folder: Path) -> list[str]:
    text = (folder / "logs/octoprint.log").read_text("utf-8")
    return [line for line in text.splitlines() if "octoprint.plugins.hframe_post" in line]


@slow
@needs_octoprint
def test_an_upload_is_gentle_and_what_fails_is_said(octoprint: Server, tmp_path: Path) -> None:
    gate, profile = tmp_path / "gate", tmp_path / "printer.toml"
    gate.touch()
    content = PART.replace(b"G1 X260 Y120", b"UNKNOWN_MACRO\nG1 X260 Y120", 1)
    arguments = ("part.gcode", content, "/api/files/local")
    with ThreadPoolExecutor(1) as executor:
        uploading = executor.submit(octoprint.upload, *arguments)
        try:
            until(lambda: len(processes(str(gate))) > 0)
            nice = [os.getpriority(os.PRIO_PROCESS, pid) for pid in processes(str(gate))]
            assert min(nice) >= min(19, os.nice(0) + 10)
        finally:
            gate.unlink()
        uploading.result()
    assert any("% of the extrusion is not compensated" in line for line in logged(tmp_path))
    profile.unlink()
    with pytest.raises(AssertionError, match=r"printer\.toml: no such profile or file"):
        octoprint.upload("part.gcode", PART, "/api/files/local")
    profile.write_text(PROFILE.read_text() + "\n[motors]\nbelt_velocity = 20.0\n")
    cause = r"did not convert this file: line \d+: belt velocity .* limit is 20; "
    with pytest.raises(AssertionError, match=cause):
        octoprint.upload("cube.gcode", CUBE, "/api/files/local")
