"""The plant of a printer, identified from sweeps that accelerometers recorded.

runs → frequency responses → transfer functions, sensor gains and x_c
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hframe_post.arrays import Flags, X
from hframe_post.errors import IdentificationError
from hframe_post.identification.diagnosis.coupling import (
    MeasuredCoupling,
    Pitch,
    find_coupling,
    pitch_note,
    pitching,
)
from hframe_post.identification.diagnosis.nonlinearity import (
    AxisSweeps,
    LinearPrinter,
    Nonlinearity,
    find_nonlinearity,
)
from hframe_post.identification.diagnosis.scatter import (
    Refit,
    Uncertainty,
    find_mode_shift,
    lever_arm_uncertainty,
    model_uncertainty,
    position_spread,
    refit_calibrated,
    session_uncertainty,
)
from hframe_post.identification.fitting.dominant import refined, share_left
from hframe_post.identification.fitting.fit import (
    Fit,
    fit,
    fit_response,
    with_common_delay,
    with_gain,
)
from hframe_post.identification.fitting.impulse import estimated
from hframe_post.identification.identified import AXIS, Identified, Measured, Repetition
from hframe_post.identification.recordings.accelerometer import GAIN_SD
from hframe_post.identification.responses.crossed import Crossed, crossed
from hframe_post.identification.responses.frequency_response import (
    Distortion,
    average,
    spread,
)
from hframe_post.identification.responses.measured import (
    Line,
    Run,
    RunGroup,
    RunResponse,
    Settings,
    bridge_responses,
    centre,
    line,
    nozzle_responses,
)
from hframe_post.identification.responses.uncalibrated import uncalibrated_responses
from hframe_post.model.impulse_response import Linear
from hframe_post.stream.running import one_blas_thread

OFF_LINE = 0.3  # of the lever arms' effect, that may deviate from the line through the positions
SAME_PLACE = 5.0  # mm

__all__ = ["Identified", "Measured", "Run", "Settings", "identify"]


@one_blas_thread()
def identify(runs: Sequence[Run], settings: Settings) -> Identified:
    """Return transfer functions and x_c from runs of x, of y, or of both.

    Raises IdentificationError.
    """
    groups = _groups(runs, settings)
    bridge = bridge_responses([run for run in runs if run.bridge], settings)
    measured = {name: _measured(group, settings) for name, group in groups.items()}
    fits, nonlinearity = _fit_axes(groups, measured, settings)
    fits = {name: _compared(found, groups[name]) for name, found in fits.items()}
    mode_shift, arm = None, None
    x_runs = groups["Gxx"].runs if "Gxx" in groups else []
    if x_runs:
        refit = _refit(measured["Gxx"], fits["Gxx"], settings)
        mode_shift = find_mode_shift(fits["Gxx"], measured["Gxx"].places, refit)
        arm = _lever_arm(x_runs, settings, mode_shift is not None)
    least = 1.0 if arm and arm.beyond_noise <= OFF_LINE else 3.0
    racking = arm if arm and arm.over_noise > least else None
    if bridge.runs:
        measured["Gxtheta"] = _measured(bridge, settings)
    elif racking:
        # made of the same recordings as Gxx, so their delay is known by now
        delay = fits["Gxx"].recording_delay
        measured["Gxtheta"] = Measured(racking.by_place, racking.slope, racking.off, (delay, delay))
    if "Gxtheta" in measured:
        distortion = nonlinearity.distortions.get("x") if nonlinearity else None
        low = 0.0 if bridge.runs else groups["Gxx"].excited_hz
        band = max(settings.band_hz[0], low), settings.band_hz[1]
        found = _fit("Gxtheta", measured["Gxtheta"], replace(settings, band_hz=band), distortion)
        if not bridge.runs:
            # an unknown excitation is wrong in x alone, an unknown sensor where it measures
            calibrated = "Gyy" in fits and groups["Gxx"].resonance_hz is None
            found = with_gain(found, fits["Gyy" if calibrated else "Gxx"].gain)
        fits["Gxtheta"] = found
    x_c = lever_arm_sd = None
    if racking:
        along = measured["Gxx"].mean
        places, ys = [run.place for run in x_runs], [run.y for run in x_runs]
        x_c, _ = centre(racking, along.H)
        lever_arm_sd = lever_arm_uncertainty(places, ys, along)
    warnings = _disagreement(arm, measured["Gxtheta"]) if arm and bridge.runs else []
    warnings += _unknown_start(measured)
    uncertainties = {
        name: _uncertainty(measured[name], found, settings) for name, found in fits.items()
    }
    repeated = {name: _repetition(measured[name], fits[name], settings) for name in groups}
    repetitions = {name: one for name, one in repeated.items() if one is not None}
    couplings = [_coupling(name, group, fits, x_c, settings) for name, group in groups.items()]
    on_head = [name for name in groups if not (settings.bed_moves and name == "Gyy")]
    pitches = [_pitching(AXIS[name], groups[name], settings) for name in on_head]
    seen = [one for one in pitches if one is not None]
    return Identified(
        measured, fits, x_c, warnings, settings.racks, arm is not None and racking is None,
        mode_shift, nonlinearity, uncertainties, lever_arm_sd, repetitions,
        [one for one in couplings if one is not None], [pitch_note(seen)] if seen else [],
    )  # fmt: skip


def _groups(runs: Sequence[Run], settings: Settings) -> dict[str, RunGroup]:
    """Return the runs of each axis; those of our own sweep, which tell more, if there are any."""
    nozzle = [run for run in runs if run.nozzle]
    groups = dict[str, RunGroup]()
    calibrated = [run for run in nozzle if run.calibrated]
    for axis, name in enumerate(AXIS):
        chosen = [run for run in calibrated if run.axis == axis]
        if chosen:
            groups[name] = nozzle_responses(chosen, settings)
    others = [run for run in nozzle if not run.calibrated]
    for axis, group in uncalibrated_responses(others, settings).items():
        groups.setdefault(tuple(AXIS)[axis], group)
    if not groups:
        raise IdentificationError("no run of the nozzle's sensor. Give one with --nozzle")
    return groups


def _measured(group: RunGroup, settings: Settings) -> Measured:
    responses = [run.response for run in group.runs]
    places = [(run.place, run.response) for run in group.runs]
    differ = spread(responses, settings.band_hz)
    low = max(settings.band_hz[0], group.excited_hz)
    return Measured(
        places, average(responses), differ, group.delay_bounds, low, group.resonance_hz,
        group.lowest_hz,
    )  # fmt: skip


def _fit_axes(
    groups: Mapping[str, RunGroup], measured: Mapping[str, Measured], settings: Settings
) -> tuple[dict[str, Fit], Nonlinearity | None]:
    """Fit Gxx and Gyy: first as if the printer were linear, then without what is distorted."""
    fits = _fit_all(measured, settings, {})
    nonlinearity = _find_nonlinearity(groups, fits, settings.step)
    if nonlinearity is None:
        # positions that differ by more than 10 % smear their mean
        differing = {
            name: one
            for name, one in measured.items()
            if one.spread > 0.1 and one.resonance_hz is None
        }
        spreads = {name: position_spread(one.runs) for name, one in differing.items()}
        fits |= _fit_all(differing, settings, spreads)
    else:
        # the linear part and the distortion depend on each other: alternate
        for _ in range(2):
            by_axis = nonlinearity.distortions
            distortions = {name: by_axis[axis] for name, axis in AXIS.items() if axis in by_axis}
            fits = _fit_all(measured, settings, distortions)
            nonlinearity = _find_nonlinearity(groups, fits, settings.step) or nonlinearity
    if len(fits) == len(AXIS):
        fits["Gxx"], fits["Gyy"] = with_common_delay(fits["Gxx"], fits["Gyy"])
    return fits, nonlinearity


def _fit_all(
    measured: Mapping[str, Measured], settings: Settings, distortions: Mapping[str, Distortion]
) -> dict[str, Fit]:
    return {
        name: _fit(name, one, settings, distortions.get(name)) for name, one in measured.items()
    }


def _fit(name: str, measured: Measured, settings: Settings, distortion: Distortion | None) -> Fit:
    excited = measured.excited(settings.band_hz)
    if excited is not None:
        return fit_response(excited)
    sensor = None
    if settings.sensor is not None and name in AXIS:
        sensor = settings.sensor[tuple(AXIS).index(name)], GAIN_SD
    return fit(
        measured.runs, measured.mean, name == "Gxtheta", settings.band_hz, measured.delay_bounds,
        distortion, sensor,
    )  # fmt: skip


def _refit(measured: Measured, found: Fit, settings: Settings) -> Refit:
    """Return the function that refines the model on another response."""
    excited = measured.excited(settings.band_hz)
    if excited is None:
        return lambda response: refit_calibrated(found.model, response.within(settings.band_hz))
    band = excited.runs[0].hz[[0, -1]]
    return lambda response: refined(response.within((band[0], band[1])), excited, found.model)


def _uncertainty(measured: Measured, found: Fit, settings: Settings) -> Uncertainty:
    if measured.resonance_hz is None:
        return model_uncertainty(found, measured.runs, settings.band_hz)
    refit = _refit(measured, found, settings)
    return session_uncertainty(found.model, [refit(run) for run in measured.runs])


def _compared(found: Fit, group: RunGroup) -> Fit:
    """Return the fit, with what a second sensor tells of a frame that rocks."""
    for run in group.runs:
        if found.rocking is not None and run.second is not None:
            return replace(found, rocking=found.rocking.compared(run.response.hz, run.second))
    return found


def _repetition(measured: Measured, found: Fit, settings: Settings) -> Repetition | None:
    """Compare recordings of the place that was recorded most often; None if none was repeated.

    Runs of our own sweep follow one another within minutes, which tells nothing of a day.
    """
    excited = measured.excited(settings.band_hz)
    if excited is None:
        return None
    near = _most_repeated([place for place, _ in measured.places])
    if np.count_nonzero(near) < 2:
        return None
    runs = [run for run, chosen in zip(excited.runs, near, strict=True) if chosen]
    shares = [share_left(one.H, other, other.power) for one, other in pairwise(runs)]
    if found.measured is not None:
        functions: tuple[Linear, ...] = tuple(estimated(run).G for run in runs)
    else:
        refit = _refit(measured, found, settings)
        functions = tuple(model.discrete(0.0, model.gain) for model in map(refit, runs))
    return Repetition(float(np.mean(shares)) / math.sqrt(2.0), functions)


def _most_repeated(places: Sequence[float]) -> Flags:
    """Flag the runs at the place (mm) that has most of them."""
    at = np.array(places)
    return max((np.abs(at - place) < SAME_PLACE for place in at), key=np.count_nonzero)


def _coupling(
    name: str, group: RunGroup, fits: Mapping[str, Fit], x_c: float | None, settings: Settings
) -> MeasuredCoupling | None:
    """Return what a command in an axis does to the other, if its recordings tell."""
    if group.resonance_hz is None:
        return None
    runs, known = crossed(tuple(AXIS).index(name), group, settings.band_hz), 0
    if name == "Gxx" and x_c is not None:
        runs, known = [_without_racking(run, fits["Gxtheta"], x_c) for run in runs], 1
    other = fits.get("Gyy" if name == "Gxx" else "Gxx")
    models = [one.model for one in (fits[name], other) if one is not None]
    return find_coupling(AXIS[name], runs, models, known) if runs else None


def _without_racking(run: Crossed, racking: Fit, x_c: float) -> Crossed:
    turned = (run.place[X] - x_c) * racking.response(run.across.hz)
    return replace(run, across=replace(run.across, H=run.across.H - turned))


def _pitching(axis: str, group: RunGroup, settings: Settings) -> Pitch | None:
    found = [
        pitching(axis, run.response, run.z, settings.height)
        for run in group.runs
        if run.z is not None
    ]
    return found[-1] if found else None


def _find_nonlinearity(
    groups: Mapping[str, RunGroup], fits: Mapping[str, Fit], step: float
) -> Nonlinearity | None:
    axes = {}
    for name, group in groups.items():
        found = fits[name]
        known = [(run.command, run.harmonics) for run in group.runs if run.harmonics is not None]
        if known:
            delay = found.recording_delay + found.printer_delay
            axes[AXIS[name]] = AxisSweeps(known, LinearPrinter(found.response, found.gain, delay))
    return find_nonlinearity(axes, step)


def _lever_arm(runs: list[RunResponse], settings: Settings, changes: bool) -> Line | None:
    """Return the line over positions whose slope is racking.

    None if the kinematics cannot rack or the positions are less than 20 mm apart. changes: whether
    the printer changes along x, so that no straight line can be expected.
    """
    places, across = [run.place for run in runs], [run.y for run in runs]
    if not settings.racks or np.ptp(places) < 20.0:
        return None
    found = line(places, across)
    if found.over_noise <= 3.0 or changes or found.beyond_noise <= OFF_LINE:
        return found
    raise IdentificationError(
        "what the nozzle does in y while x sweeps does not grow with the position: "
        f"{100 * found.beyond_noise:.0f} % of it deviate from a straight line. "
        "Are files of two places exchanged, or was the sensor moved between runs?"
    )


def _disagreement(arm: Line, bridge: Measured) -> list[str]:
    by_bridge, by_arm = bridge.mean.H, arm.slope.H
    weight = arm.slope.power * arm.slope.coherence
    size = float((weight * np.abs(by_arm) ** 2).sum())
    ratio = float((weight * by_bridge * by_arm.conj()).sum().real) / size
    if ratio < 0.0:
        raise IdentificationError(
            "the bridge's sensors see the gantry turn the other way than the nozzle's sensor: P1 "
            "must be the one at the greater x, and both need their own --axes"
        )
    off = math.sqrt(float((weight * np.abs(by_bridge - by_arm) ** 2).sum()) / size)
    message = (
        f"racking by the bridge's sensors is {ratio:.2f} times that by the nozzle's at several "
        f"places, and {100 * off:.0f} % off: check --bridge-length"
    )
    return [message] if off > 0.2 else []


def _unknown_start(measured: Mapping[str, Measured]) -> list[str]:
    bounds = [one.delay_bounds for one in measured.values()]
    widest = max(high - low for low, high in bounds) / 2.0
    message = (
        f"the start of a recording is known to ±{widest * 1e3:.1f} ms only, so x, y and racking "
        "may be late relative to each other by as much. Record with Klipper, whose files tell "
        "the start"
    )
    return [message] if widest > 1e-3 else []
