"""``setup`` from printer.cfg or M503, again after changes, and wrong input."""

import os
import pty
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hframe_post.hosts.klipper.kernel_file import read
from hframe_post.printer import model_file
from hframe_post.printer.firmware_tables import KlipperTable, MarlinTable
from hframe_post.printer.model_file import measured
from hframe_post.printer.profile import load
from hframe_post.process import program
from tests.command_line import RECTANGLE, run
from tests.command_server import call
from tests.conftest import ROOT
from tests.printers import M503, REAL, in_one


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "printer.cfg"
    path.write_text(REAL.read_text())
    return path


def set_up(config: Path, *options: str | Path, status: int = 0) -> str:
    """Run setup into the folder of printer.cfg and return what it printed, as one text."""
    folder = config.parent
    home = str(folder / "config")
    done = run("setup", config, "-o", folder, *options, XDG_CONFIG_HOME=home)
    assert done.returncode == status, done.stderr
    return (done.stdout + done.stderr).decode()


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_setup_writes_profile_and_macros_and_makes_the_profile_the_default(config: Path) -> None:
    before = config.read_text()
    printed = set_up(config)
    profile = load(str(config.parent / "printer.toml"))
    assert "[gcode_macro _HFRAME_END]" in (config.parent / "hframe.cfg").read_text()
    assert "[include hframe.cfg]" in printed
    assert config.read_text() == before
    assert profile.invented
    home = str(config.parent / "config")
    at_home = partial(run, XDG_CONFIG_HOME=home, HFRAME_PRINTER="")
    assert str(config.parent / "printer.toml") in at_home("doctor").stdout.decode()
    assert at_home(RECTANGLE, "-n").returncode == 0
    assert at_home("connect", "klipper").stdout == (config.parent / "hframe.cfg").read_bytes()


def test_the_name_of_a_profile_is_no_folder(config: Path) -> None:
    done = run("setup", config, "-o", config.parent / "my.toml")
    assert done.returncode == 2
    assert f"write -o {config.parent}" in done.stderr.decode()
    assert [*config.parent.iterdir()] == [config]


def test_again_it_changes_nothing_and_says_what_differs(config: Path) -> None:
    own = config.parent / "printer.toml"
    set_up(config)
    written = [path for path in config.parent.rglob("*") if path.is_file()]
    first = [(path.read_bytes(), path.stat().st_mtime_ns) for path in written]
    assert "no changes" in set_up(config)
    assert [(path.read_bytes(), path.stat().st_mtime_ns) for path in written] == first
    edited(own, "z_velocity = 20", "z_velocity = 15")
    edited(own, "dialect = ", 'harmless = ["BEEP"]\ndialect = ')
    edited(config, "max_accel: 10000", "max_accel: 8000")
    before = own.read_bytes()
    printed = set_up(config)
    assert own.read_bytes() == before
    assert "limits.acceleration: 8000 (max_accel of [printer]), but" in printed
    assert "limits.z_velocity: 20" in printed
    assert f"To overwrite it: hframe-post setup {config} --reset" in printed
    set_up(config, "--reset")
    profile = load(str(own))
    assert (profile.limits.acceleration, profile.firmware.harmless) == (8000.0, ())


def test_what_the_printer_has_no_more_goes(config: Path) -> None:
    """Input shaping and firmware retraction, which doctor would report for ever."""
    before = config.read_text()
    assert "[firmware_retraction]" in before
    edited(config, "[input_shaper]", "[input_shaper]\nshaper_freq_x: 51.5")
    set_up(config)
    own = config.parent / "printer.toml"
    has = load(str(own))
    assert has.firmware.own(KlipperTable).shaper_freq_x == 51.5
    assert has.retraction is not None
    config.write_text(before.replace("[firmware_retraction]", "[unused]"))
    printed = set_up(config, "--reset")
    assert "[retraction]: the printer has none any more" in printed
    has = load(str(own))
    assert has.firmware.own(KlipperTable).shaper_freq_x == 0.0
    assert has.retraction is None
    assert "no changes" in set_up(config)


# a Voron 2.4 with parts and Mainsail; a bed-slinger with two sensors and a block commented out
OWNERS = Path(__file__).with_name("owners")


@pytest.mark.parametrize(
    ("owner", "kind", "sensors", "hz"),
    [("voron", "corexy", "adxl345", 62.4), ("bedslinger", "cartesian", "hotend, bed", 0.0)],
)
def test_setup_and_doctor_read_owners_files(
    tmp_path: Path, owner: str, kind: str, sensors: str, hz: float
) -> None:
    shutil.copytree(OWNERS / owner, tmp_path, dirs_exist_ok=True)
    config, own = tmp_path / "printer.cfg", tmp_path / "printer.toml"
    printed = set_up(config)
    assert "WARNING" not in printed
    assert f"accelerometer    {sensors}\n" in printed
    assert "no changes" in set_up(config)
    profile = load(str(own))
    assert profile.kinematics.type == kind
    assert profile.steps is not None
    assert profile.firmware.own(KlipperTable).shaper_freq_x == hz, "Hz"
    checked = run("doctor", "-p", own, "--printer-cfg", config, HFRAME_PRINTER=str(own))
    assert (checked.returncode, b"PROBLEM" in checked.stdout) == (0, False), checked.stdout


def test_again_it_keeps_an_identified_plant(config: Path) -> None:
    own = config.parent / "printer.toml"
    set_up(config, "--kinematics", "hbot")
    paper = load("paper")
    found = measured(load(str(own)), paper.plant, None, None)
    texts = model_file.texts(found.with_windows(paper.compensation.windows), str(own), own)
    edited(config, "max_accel: 10000", "max_accel: 8000")
    own.write_text(inside := in_one(texts.printer, str(own)))
    assert "contains what was measured" in set_up(config, "--reset", status=1)
    assert own.read_text() == inside
    own.write_text(texts.profile)
    own.with_suffix(".model.toml").write_text(texts.model)
    set_up(config, "--reset")
    assert 'model = "printer.model.toml"' in own.read_text()
    profile = load(str(own))
    assert profile.limits.acceleration == 8000.0
    np.testing.assert_allclose(profile.plant.Gxx.deviation, paper.plant.Gxx.deviation, atol=1e-4)
    assert profile.plant.Gxtheta is not None
    assert not profile.invented
    assert profile.compensation.effort == paper.compensation.effort


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[printer]\nmax_velocity: \xff\n", "cannot be read as text: save it as UTF-8"),
        (b'extends = "paper"\n[travel]\nx = [0, 1]\n', "is a profile of hframe-post"),
        (b"#define X_BED_SIZE 220\n", "Send M503 to the printer"),
        (b"[extruder]\nnozzle_diameter: 0.4\n", "no section [printer]"),
        (b"[include gone.cfg]\n", "[include gone.cfg] finds no file"),
        (b"[include printer.cfg]\n", "[include printer.cfg] includes a file in itself"),
        (b"[printer]\nkinematics: delta\n", "kinematics: delta"),
        (b"[printer]\nkinematics: corexy\n", "[printer] max_velocity is missing"),
        (b"[printer]\nkinematics: corexy\nmax_velocity: 9\nmax_accel: 9\n", "position_max"),
        (b"[printer]\nkinematics: corexy\nmax_velocity: 9%s\n" % (b"9e" * 9999), "not a number"),
        (b"# mine\nnonsense\n", "printer.cfg:2 is neither a [section]"),
        (b"", "no section [printer]"),
    ],
)
def test_what_is_no_printer_cfg_is_refused(config: Path, content: bytes, message: str) -> None:
    config.write_bytes(content)
    printed = set_up(config, status=1)
    assert message in printed
    assert printed.startswith("Error: ")
    assert printed.count("\n") == 1
    assert len(printed) < 500
    assert sorted(each.name for each in config.parent.iterdir()) == ["printer.cfg"]


def test_answers_of_marlin_make_a_profile_without_macros(tmp_path: Path) -> None:
    answers = tmp_path / "m503.txt"
    answers.write_text(M503.read_text())
    printed = set_up(answers)
    own = tmp_path / "printer.toml"
    assert load(str(own)).firmware.dialect == "marlin"
    assert load(str(own)).kinematics.type == "cartesian"
    assert not (tmp_path / "hframe.cfg").exists()
    assert "Klipper" not in printed
    assert "--kinematics corexy" in printed
    edited(own, "\nmax_acceleration_e", '\nplanner = "2.0"\nmax_acceleration_e')
    edited(answers, "J0.08", "J0.02")
    again = ("--bed", "300,200", "--kinematics", "hbot")
    assert " ".join([*again, "--reset"]) in set_up(answers, *again)
    assert load(str(own)).kinematics.type == "cartesian"
    printed = set_up(answers, *again, "--reset")
    assert 'firmware.marlin.planner: "2.1"' in printed
    profile = load(str(own))
    assert profile.kinematics.racks
    assert (profile.travel.x, profile.travel.y) == ((0.0, 300.0), (0.0, 200.0))
    table = profile.firmware.own(MarlinTable)
    assert (table.junction_deviation, table.planner) == (0.02, "2.1")
    done = run(RECTANGLE, "-n", "-p", own)
    assert done.returncode == 0, done.stderr


# ---------------------------------------------------------------------- Moonraker


def connect(config: Path, *options: str) -> str:
    done = run("connect", "moonraker", "--printer-cfg", config, *options)
    assert done.returncode == 0, done.stderr
    return done.stdout.decode()


@pytest.fixture
def moonraker(config: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Moonraker as far as setup looks at it, and a measured profile; the components folder."""
    monkeypatch.setenv("HOME", str(config.parent))
    config.with_name("moonraker.conf").write_text(
        "[server]\nport: 7125\n\n[history]\n# no [hframe_post]\n"
    )
    components = config.parent / "moonraker/moonraker/components"
    components.mkdir(parents=True)
    config.with_name("printer.toml").write_text((ROOT / "tests/measured.toml").read_text())
    return components


def test_moonraker_is_connected_and_disconnected(config: Path, moonraker: Path) -> None:
    conf, link = config.with_name("moonraker.conf"), moonraker / "hframe_post"
    before = conf.read_text()
    printed = connect(config)
    assert "sudo systemctl restart klipper moonraker" in printed
    assert link.resolve() == ROOT / "hframe_post/hosts/moonraker"
    connected = conf.read_text()
    assert connected.startswith(before)
    assert f"[hframe_post]\ncommand: {program()} -p {config.parent}/printer.toml\n" in connected
    conf.write_text(connected.replace("printer.toml", "printer.toml --limits printer"))
    connect(config)
    assert conf.read_text().count("\n[hframe_post]\n") == 1
    assert "--limits printer" in conf.read_text()  # what was changed by hand stays
    moved, gone = conf.read_text(), "/gone/bin/hframe-post"
    conf.write_text(moved.replace(f"command: {program()}", f"command: {gone}"))
    assert f"command corrected, because {gone} is gone" in connect(config)
    assert conf.read_text() == moved
    conf.write_text(conf.read_text() + "\n[timelapse]\n")
    connect(config, "--remove")
    assert conf.read_text() == before + "\n[timelapse]\n"
    assert not link.is_symlink()
    connect(config, "--remove")
    assert conf.read_text() == before + "\n[timelapse]\n"


def test_klipper_itself_compensates_where_it_is_found(config: Path, moonraker: Path) -> None:
    klipper, conf = config.parent / "klipper", config.with_name("moonraker.conf")
    (klipper / "klippy/extras").mkdir(parents=True)
    (klipper / ".git/info").mkdir(parents=True)
    before = config.read_text(), conf.read_text()
    for _ in range(2):
        connect(config)
        link = klipper / "klippy/extras/hframe_live"
        assert link.resolve() == ROOT / "hframe_post/hosts/klipper"
        assert (klipper / ".git/info/exclude").read_text() == "/klippy/extras/hframe_live\n"
        assert config.read_text().count("\n[hframe_live]\nkernel: printer.kernel\n") == 1
        assert conf.read_text().count("[hframe_post]\ncommand: ") == 1
    assert read(config.with_name("printer.kernel").read_bytes())["kinematics"] == "corexy"
    said = run(
        "doctor", "-p", config.with_name("printer.toml"), "--printer-cfg", config
    ).stdout.decode()
    assert "printer.kernel: hframe-post" in said
    connect(config, "--remove")
    assert (config.read_text(), conf.read_text()) == before
    assert not link.is_symlink()


def test_an_owner_may_leave_the_compensation_to_the_slicer(config: Path, moonraker: Path) -> None:
    (config.parent / "kalico/klippy/plugins").mkdir(parents=True)
    (config.parent / "kalico/klippy/extras").mkdir()
    link = config.parent / "kalico/klippy/plugins/hframe_live"
    at_a_terminal(b"n\ny\n", "connect", "moonraker", "--printer-cfg", str(config))
    assert not link.is_symlink()
    assert "hframe_live" not in config.read_text()
    at_a_terminal(b"y\ny\n", "connect", "moonraker", "--printer-cfg", str(config))
    assert link.is_symlink()
    assert "[hframe_live]" in config.read_text()
    at_a_terminal(b"n\ny\n", "connect", "moonraker", "--printer-cfg", str(config))
    assert not link.is_symlink()  # and Klipper would not start with a section of it
    assert "hframe_live" not in config.read_text()


def test_macros_are_included_above_what_klipper_saved(config: Path, moonraker: Path) -> None:
    end = "\r\n"
    saved = "#*# <---------------------- SAVE_CONFIG ---------------------->\n#*# [probe]\n"
    before = (config.read_text() + "\n" + saved).replace("\n", end).encode()
    config.write_bytes(before)
    printed = connect(config)
    assert f"+[include hframe.cfg]{end}".strip() in printed
    lines = config.read_text().splitlines()
    assert lines[lines.index("[include hframe.cfg]") + 1].startswith("#*# <---")
    assert config.with_name("printer.cfg.before-hframe-post").read_bytes() == before
    files = {each: each.read_bytes() for each in config.parent.rglob("*") if each.is_file()}
    assert "added" not in connect(config)
    assert files == {each: each.read_bytes() for each in config.parent.rglob("*") if each.is_file()}
    connect(config, "--remove")
    assert config.read_bytes() == before
    assert not config.with_name("hframe.cfg").exists()


@pytest.mark.slow
def test_the_printers_files_are_found(config: Path, moonraker: Path) -> None:
    done = run("connect", "moonraker")
    assert b"Name it: hframe-post connect moonraker --printer-cfg" in done.stderr
    folder = config.parent / "printer_data/config"
    folder.mkdir(parents=True)
    for name in ("printer.cfg", "moonraker.conf"):
        (folder / name).write_bytes(config.with_name(name).read_bytes())
    before = {path: path.read_bytes() for path in folder.iterdir()}
    asked, status = at_a_terminal(b"\nn\n", "connect", "moonraker")
    assert asked.count(b"Make these changes?") == 1
    assert status == 0
    assert before == {path: path.read_bytes() for path in folder.iterdir()}
    asked, _ = at_a_terminal(b"\ny\n", "connect", "moonraker")
    assert b"HFRAME_CALIBRATE" in asked
    assert (folder / "printer.toml").is_file()
    assert (moonraker / "hframe_post").is_symlink()
    shutil.copytree(folder, config.parent / "second_data/config")
    assert b"there are several printer.cfg: " in run("connect", "moonraker").stderr


def at_a_terminal(typed: bytes, *arguments: str) -> tuple[bytes, int]:
    """Type answers to a command at a terminal; return what it shows, and its status."""
    ours, theirs = pty.openpty()
    os.write(ours, typed)
    done = call("hframe_post.__main__", ["hframe-post", *arguments], os.environ, terminal=theirs)
    os.close(theirs)
    os.close(ours)
    return done.stdout, done.returncode
