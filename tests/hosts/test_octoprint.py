"""The plugin in the real OctoPrint.

OCTOPRINT_PYTHON names a Python in which OctoPrint is installed, as ``make hosts`` does.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.command_line import RECTANGLE, run
from tests.conftest import ROOT
from tests.hosts.moonraker import Server, free_port, until

PYTHON = os.environ.get("OCTOPRINT_PYTHON", "")
PROFILE = ROOT / "tests/measured.toml"
PART = RECTANGLE.read_bytes()
KEY = "0123456789ABCDEF0123456789ABCDEF"
CONFIG = f"""\
server: {{firstRun: false, onlineCheck: {{enabled: false}}, pluginBlacklist: {{enabled: false}}}}
api: {{key: {KEY}}}
accessControl: {{salt: abc}}
plugins: {{_disabled: [tracking, softwareupdate, announcements, discovery, pluginmanager]}}
"""
USER = "me: {active: true, apikey: null, groups: [admins], password: x, permissions: [], roles: []}"


def test_the_plugin_is_installed_for_a_measured_printer(tmp_path: Path) -> None:
    done = run("octoprint-plugin", "-p", PROFILE, "--folder", tmp_path)
    plugin = (tmp_path / "plugins/hframe_post.py").read_text()
    assert done.stdout.decode().startswith(f"{tmp_path}/plugins/hframe_post.py\n")
    assert f", '-p', '{PROFILE}']\n" in plugin
    refused = run("octoprint-plugin", "-p", "paper", "--folder", tmp_path)
    assert refused.returncode == 1
    assert b"not measured" in refused.stderr
    missing = run("octoprint-plugin", "-p", PROFILE, HOME=str(tmp_path))
    assert b".octoprint does not exist" in missing.stderr
    assert (tmp_path / "plugins/hframe_post.py").read_text() == plugin


@pytest.fixture
def octoprint(tmp_path: Path) -> Iterator[Server]:
    (tmp_path / "config.yaml").write_text(CONFIG)
    (tmp_path / "users.yaml").write_text(USER)
    run("octoprint-plugin", "-p", PROFILE, "--folder", tmp_path)
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


@pytest.mark.slow
@pytest.mark.skipif(not PYTHON, reason="OCTOPRINT_PYTHON names no Python with OctoPrint")
def test_an_upload_is_converted_or_fails_with_the_reason(octoprint: Server, tmp_path: Path) -> None:
    stored, expected = tmp_path / "uploads/part.gcode", tmp_path / "expected.gcode"
    run(RECTANGLE, "-o", expected, "-p", PROFILE)
    for content in (PART, expected.read_bytes()):
        octoprint.upload("part.gcode", content, "/api/files/local")
        assert stored.read_bytes() == expected.read_bytes()
    with pytest.raises(AssertionError, match=r"did not convert this file: line .* 9000"):
        octoprint.upload("part.gcode", PART + b"G1 X9000 F6000\n", "/api/files/local")
    assert stored.read_bytes() == expected.read_bytes()  # that of the last upload that succeeded
    octoprint.upload("marked.gcode", b"; hframe-post: off\n" + PART, "/api/files/local")
    assert (tmp_path / "uploads/marked.gcode").read_bytes().endswith(PART)
