"""The real Moonraker with the component, in front of the real Klipper host."""

import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tests.command_line import run
from tests.conftest import ROOT
from tests.klipper.batch import dictionary
from tests.klipper.host import TEMPLATE

WAIT = 300.0  # s until a test fails: machines that build many things at once are slow
CONFIG = """\
[server]
host: 127.0.0.1
port: {port}
klippy_uds_address: {data}/klippy.sock
[authorization]
trusted_clients: 127.0.0.1
[machine]
provider: none
validate_service: False
[octoprint_compat]
[history]
[announcements]
"""


class Server:
    """A program that takes uploads by HTTP."""

    def __init__(self, port: int, headers: Mapping[str, str]) -> None:
        self.port, self._headers = port, headers

    def request(self, method: str, path: str, body: bytes = b"", kind: str = "") -> Any:
        with closing(HTTPConnection("127.0.0.1", self.port, timeout=600.0)) as connection:
            headers = {**self._headers, **({"Content-Type": kind} if kind else {})}
            connection.request(method, path, body, headers)
            response = connection.getresponse()
            answer = response.read()
        assert response.status < 300, answer
        return json.loads(answer)

    def upload(self, name: str, content: bytes, path: str) -> Any:
        """Upload a file as slicers do: a form with the file."""
        boundary = secrets.token_hex(16)
        head = (
            f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
            "Content-Type: application/octet-stream\r\n\r\n"
        )
        body = head.encode() + content + f"\r\n--{boundary}--\r\n".encode()
        return self.request("POST", path, body, f"multipart/form-data; boundary={boundary}")


class Printer(Server):
    """Klipper's host and Moonraker with hframe-post, set up as the owner of a sensor does.

    python: one that has Moonraker, whose code is copied, so that the component is linked there.
    options: lines of the component's section. sensor: of printer.cfg.
    """

    def __init__(self, python: Path, folder: Path, options: str, sensor: str) -> None:
        super().__init__(free_port(), {})
        self.data, self.home, self._python = folder / "printer_data", folder, python
        self._processes: list[subprocess.Popen[bytes]] = []
        for name in ("config", "gcodes", "logs", "comms"):
            (self.data / name).mkdir(parents=True)
        where = [str(python), "-c", "import moonraker; print(moonraker.__path__[0])"]
        code = subprocess.check_output(where, text=True).strip()
        self.components = folder / "moonraker/moonraker/components"
        shutil.copytree(code, self.components.parent)
        self.config = self.data / "config/moonraker.conf"
        self.config.write_text(CONFIG.format(port=self.port, data=self.data))
        (self.data / "config/printer.cfg").write_text(
            f"{TEMPLATE.read_text()}\n[virtual_sdcard]\npath: {self.data}/gcodes\n[pause_resume]\n"
            f"[display_status]\n{sensor}\n[include hframe.cfg]\n"
        )
        (self.data / "config/hframe.cfg").touch()
        self.profile = self.data / "config/printer.toml"
        self.set_up()
        as_set_up = self.config.read_text()
        self.config.write_text(as_set_up.replace("command: ", f"{options}command: ", 1))

    def set_up(self) -> None:
        config = self.data / "config/printer.cfg"
        done = run(
            "connect", "moonraker", "--printer-cfg", config,
            HOME=str(self.home), XDG_CONFIG_HOME=str(self.home / ".config"),
        )  # fmt: skip
        assert done.returncode == 0, done.stderr

    def start_klipper(self) -> None:
        messages = self.data / "messages.json"
        messages.write_text(json.dumps(dictionary()))
        (self.data / "input").touch()
        self._start(
            "klipper", [sys.executable, "-P", "-m", "tests.hosts.klipper_server"],
            self.data / "config/printer.cfg", "-i", self.data / "input", "-o", os.devnull,
            "-d", messages, "-l", self.data / "logs/klippy.log", "-a", self.data / "klippy.sock",
            PYTHONPATH=str(ROOT), TMPDIR=str(self.data),
        )  # fmt: skip

    def start_moonraker(self) -> None:
        """Start it and wait until it answers."""
        code = str(self.components.parents[1])
        self._start(
            "moonraker", [self._python, "-m", "moonraker"], "-d", self.data, PYTHONPATH=code
        )
        until(lambda: "hframe_post" in self.get("/server/info")["components"])

    def _start(self, name: str, command: list[Any], *arguments: Any, **environment: str) -> None:
        with (self.data / f"{name}.out").open("wb") as output:
            process = subprocess.Popen(
                [str(word) for word in (*command, *arguments)], cwd=self.data, stdout=output,
                stderr=output, env={**os.environ, **environment}, start_new_session=True,
            )  # fmt: skip
        self._processes.append(process)

    def stop(self) -> None:
        """Kill each program with all that it started, as systemd does."""
        for process in self._processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        # Moonraker's reader of metadata has a session of its own and outlives it
        for left in processes(str(self.components)):
            with suppress(ProcessLookupError):
                os.kill(left, signal.SIGKILL)

    def get(self, path: str) -> Any:
        return self.request("GET", path)["result"]

    def console(self) -> list[str]:
        return [
            entry["message"] for entry in self.get("/server/gcode_store?count=200")["gcode_store"]
        ]

    def type(self, command: str) -> None:
        self.request("POST", f"/printer/gcode/script?script={quote(command)}")


def waiting_for(gate: Path) -> list[str]:
    """Return the first words of a command that waits while a file exists."""
    return [sys.executable, str(Path(__file__).with_name("gate.py")), str(gate)]


def processes(word: str) -> list[int]:
    """Return the processes whose commands have a word that begins so."""
    found = []
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = process.read_bytes().decode(errors="replace").split("\0")
            found += [int(process.parent.name)] * any(each.startswith(word) for each in words)
    return found


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def until(holds: Callable[[], bool]) -> None:
    """Wait until ``holds()`` is true without an error of the connection; fail after WAIT."""
    deadline = time.monotonic() + WAIT
    while True:
        try:
            if holds():
                return
        except (OSError, AssertionError, HTTPException):
            pass
        assert time.monotonic() < deadline, f"not within {WAIT:g} s"
        time.sleep(0.05)
