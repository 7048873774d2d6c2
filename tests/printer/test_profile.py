"""Shipped profiles load, as unmeasured; errors in a profile name the key and the reason."""

import re
from pathlib import Path

import pytest

from hframe_post.conversion.pipeline import prepared
from hframe_post.errors import PrinterError
from hframe_post.printer.profile import load, parse, shipped
from tests.command_line import RECTANGLE, run

PAPER = shipped()["paper"]


def error(text: str) -> PrinterError:
    with pytest.raises(PrinterError) as caught:
        parse(text, "mine")
    assert caught.value.source == "mine"
    assert "\n" not in str(caught.value)
    return caught.value


def edited(pattern: str, replacement: str) -> str:
    """Return a profile that extends the paper's with one change."""
    text, changes = re.subn(pattern, replacement, PAPER, count=1, flags=re.MULTILINE | re.DOTALL)
    assert changes == 1
    return text


def extending(text: str) -> str:
    return 'extends = "paper"\n' + text


@pytest.mark.parametrize("name", shipped())
def test_shipped_profile_loads_and_can_be_compensated(name: str) -> None:
    profile = load(name)
    assert profile.name == name
    assert profile.description
    assert prepared(profile) is not None


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_file_is_loaded_and_named_by_its_stem(encoding: str, tmp_path: Path) -> None:
    """Also as PowerShell writes it."""
    path = tmp_path / "my printer.toml"
    path.write_text(PAPER, encoding=encoding)
    profile = load(str(path))
    assert profile.name == "my printer"
    assert profile.digest == load("paper").digest


def test_extension_takes_the_rest_from_its_base() -> None:
    paper = load("paper")
    text = "[limits]\nvelocity = 120\n[compensation]\neffort = [1.0, 2]\n[speed]\nmax_error = 0.03"
    mine = parse(extending(text), "mine")
    assert (paper.speed.max_error, mine.speed.max_error) == (0.0, 0.03)
    assert mine.limits.velocity == 120.0
    assert mine.limits.acceleration == paper.limits.acceleration
    assert mine.compensation.effort == (1.0, 2.0)
    assert mine.compensation.n_C == paper.compensation.n_C
    assert mine.firmware == paper.firmware
    assert mine.description == paper.description


def digest(text: str) -> str:
    return parse(text, "mine").digest


def test_digest_changes_with_content_and_with_nothing_else() -> None:
    assert digest(PAPER) == digest("# a comment\n" + PAPER) == load("paper").digest
    assert digest(extending("")) == load("paper").digest
    changes = (
        "[limits]\nvelocity = 299.0",
        "[plant]\nx_c = 141.0",
        "[firmware.klipper]\nend_macro = 'BEGIN'",
        '[compensation]\nstops = "exact"',
    )
    assert len({digest(PAPER), *(digest(extending(change)) for change in changes)}) == 5


@pytest.mark.parametrize(
    ("text", "key", "cause"),
    [
        ("colour = 3", "colour", "unknown key"),
        ("[sweep]\nstroke = 5", "sweep.stroke", "is gone, delete it: Klipper is measured"),
        ("[limits]\nvelocty = 3", "limits.velocty", "nearest known is 'velocity'"),
        ("[firmware.klipper]\naccelaration = 3", "firmware.klipper.accelaration",
         "nearest known is 'acceleration'"),
        ("[limits]\nvelocity = 'fast'", "limits.velocity", "must be a number"),
        ("[limits]\nvelocity = 0", "limits.velocity", "at least 1"),
        ("[limits]\nvelocity = 1" + 400 * "0", "limits.velocity", "must be a number"),
        ("[travel]\nx = [0.0]", "travel.x", "list of two"),
        ("[travel]\nx = [280, 0]", "travel.x", "not below"),
        ("[compensation]\nL = 5.5", "compensation.L", "whole number"),
        ("[compensation]\nn_up = 89", "compensation", "n_up ≤ n_C"),
        ("[compensation]\nstrategy = 'best'", "compensation.strategy", "none, fbs, racking"),
        ("[firmware]\ndialect = 'marlin'", "firmware.marlin", "table is missing"),
        ("[firmware]\ndialect = 'other'", "firmware.dialect", "one of klipper, marlin"),
        ("[firmware.klipper]\nend_macro = 3", "firmware.klipper.end_macro", "must be text"),
        ("[firmware.klipper]\nminimum_cruise_ratio = 1.0",
         "firmware.klipper.minimum_cruise_ratio", "below 1"),
        ("[kinematics]\ntype = 'delta'", "kinematics.type", "hybrid-corexy, corexz, cart"),
        ("[kinematics]\nswap = 1", "kinematics.swap", "true or false"),
        ("[kinematics]\nsigns = [1, 2]", "kinematics.signs", "one of -1, 1"),
        ("kinematics = 'hbot'", "kinematics", "table is missing"),
        ("[kinematics]\ntype = 'corexy'", "plant.Gxtheta", "does not rack"),
        ("[limits]\nvelocity = 1e14", "limits.velocity", "at most 10000"),
        ("[limits]\nacceleration = 2", "limits", "with this acceleration full speed takes 150 s"),
        ("[compensation]\nL = 300\nn_C = 7\nn_up = 3", "compensation", "window of 2100 samples"),
        ("[firmware.klipper]\nend_macro = \"A\\nG1 X9999\"", "firmware.klipper.end_macro",
         "one line of printable text"),
        ("[plant]\nTs = 0.002", "plant.Ts", "must be 0.001"),
        ("[plant]\nGxx = 1.0", "plant.Gxx", "must be a table"),
        ("[speed]\nmax_error = { infill = 0.1 }", "speed.max_error", "must be a number"),
        ("[speed]\nmax_error = 11", "speed.max_error", "must be at most 10"),
        ("[speed]\nmax_error = '30um'", "speed.max_error", "must be a number"),
    ],
)  # fmt: skip
def test_bad_value_is_an_error_with_its_key(text: str, key: str, cause: str) -> None:
    found = error(extending(text))
    assert (found.key, cause in found.cause) == (key, True), str(found)


def function(gain: str, zeros: str, poles: str) -> PrinterError:
    return error(extending(f"[plant.Gxx]\ngain = {gain}\nzeros = {zeros}\npoles = {poles}\n"))


@pytest.mark.parametrize(
    ("gain", "zeros", "poles", "cause"),
    [
        ("0.0", "[]", "[[1.0, 0.0]]", "unstable"),
        ("0.6", "[]", "[[0.5, 0.0]]", "gain at rest must be 1, it is 1.2"),
        ("1.0", "[]", "[[0.5, 0.1]]", "conjugate pairs"),
        ("1.0", "[[0.5, 0.0]]", "[]", "more zeros than poles"),
        ("1.0", "[]", "[[nan, 0.0]]", "number"),
        ("0.5", "3", "[[0.5, 0.0]]", "pairs"),
        ("0.5", "[]", "[[0.5, false]]", "number"),
        ("1" + 400 * "0", "[]", "[[0.5, 0.0]]", "number"),
        ("0.5", "[[1e9, 0.0]]", "[[0.5, 0.0]]", "at most 100000"),
        ("0.5", "[]", "[" + 51 * "[0.5, 0.0]," + "]", "at most 50 roots"),
        ("1e14", "[]", str([[0.9999999999999999, 0.0]] * 50), "gain at rest must be 1"),
    ],
)
def test_bad_transfer_function_is_an_error(gain: str, zeros: str, poles: str, cause: str) -> None:
    found = function(gain, zeros, poles)
    assert found.key.startswith("plant.Gxx")
    assert cause in found.cause


@pytest.mark.parametrize(
    ("pattern", "key"),
    [
        (r"^\[plant\.Gxx\].*?(?=^\[plant\.Gyy\])", "plant.Gxx"),
        (r"^poles = .*?^\]\n", "plant.Gxx.poles"),
        (r"^\[travel\].*?(?=^\[limits\])", "travel"),
        (r"^\[firmware.klipper\].*?(?=^\[plant\])", "firmware.klipper"),
    ],
)
def test_missing_key_or_table_is_an_error(pattern: str, key: str) -> None:
    found = error(edited(pattern, ""))
    assert (found.key, "missing" in found.cause) == (key, True)


@pytest.mark.parametrize("text", ["[limits", "a = ", "a = 1\na = 2", "velocity 3", "\x00"])
def test_what_is_not_toml_is_an_error(text: str) -> None:
    assert "not valid TOML" in error(text).cause


@pytest.mark.parametrize("name", shipped())
def test_no_shipped_plant_and_no_copy_of_one_is_the_users(name: str) -> None:
    assert load(name).invented
    copied = shipped()[name]
    assert parse(copied, "copy").invented
    assert parse(f'extends = "{name}"\n', "own").invented


def test_a_plant_of_unknown_origin_is_not_measured_until_its_profile_says_so() -> None:
    unknown = shipped()["paper"]
    assert parse(unknown, "old copy").invented
    assert not parse(unknown.replace("[plant]", "[plant]\ninvented = false"), "typed").invented


def test_command_line_refuses_says_what_to_do_and_can_be_overruled(tmp_path: Path) -> None:
    out, folder = tmp_path / "out.gcode", tmp_path / "many"
    line = (RECTANGLE, "-o", out, "-p", "example-corexy")
    for refused in (run(*line), run("batch", RECTANGLE, "-o", folder, "-p", "example-corexy"),
                    run("measure", "--for=check", "-o", out, "-p", "example-corexy")):  # fmt: skip
        assert refused.returncode == 1
        assert b": this printer is not measured yet" in refused.stderr
        assert b"'hframe-post measure -o measure.gcode'" in refused.stderr
        assert b"sweep" not in refused.stderr
        assert b"--force" not in refused.stderr
    marlin = run(RECTANGLE, "-o", out, "-p", "example-ender")
    assert b"'hframe-post calibrate-print'" in marlin.stderr
    assert not out.exists()
    assert not folder.exists()
    assert run(*line, "-c", "none").returncode == 0
    assert run(*line, "--force").returncode == 0
    done = run("batch", RECTANGLE, "-o", folder, "-p", "example-corexy", "--force")
    assert done.returncode == 0, done.stderr
    assert run(RECTANGLE, "-n", "-p", "example-corexy").returncode == 0  # nothing is written
    assert b": this printer is not measured yet" in run("doctor", "-p", "example-corexy").stdout
