"""The fastest print whose predicted error stays within a bound, on printers a little off, too.

Error grows nearly in proportion to the acceleration of the path and to the speed at its
corners, and it is local: each kind of feature can be driven as hard as its own bound allows. So

 1. on pieces from all over the print: which of the drawn printers decide, and with which limit
    on jerk, speed at corners and hurry between features it takes the least time within the bound;
 2. by planning alone: the feed of layers that would be over too soon;
 3. on the whole print and the printers that decide: whether the bound holds. If not, or if more
    is allowed, each kind is corrected by its error, and the whole print is judged again.

What was judged last is what is taken, so its error is a prediction and no extrapolation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

from hframe_post.conversion.pipeline import Options
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.printer.settings import Printer
from hframe_post.resources import one_blas_thread, release_memory
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.studies.speed.bound import AIM, TINY, Bound, gentler, harder, milder, slower
from hframe_post.studies.speed.cooling import Cooling
from hframe_post.studies.speed.drive import Drive, Lines, Original
from hframe_post.studies.speed.pieces import Pieces
from hframe_post.studies.speed.trial import AS_IT_IS, Driven, Freedom, Measure, Trial

ROUNDS, MOST_ROUNDS = 2, 6  # of the whole print; more only while none is within the bound
HOLDS = 0.95  # share of a bound that the judged printers may use up: another may be worse
SAFER = 0.85  # of that share, after each round that did not keep it
NEAR = 0.85  # share of a bound from which a kind is as fast as it can be
DRAWS, SEED = 40, 0  # printers that are off by the model error, on which a bound must hold too
MOST_SPEED_UP = 20.0  # times the file's feed; what the printer allows binds long before
HARDLY = 0.05  # share of the time below which it is not worth while


@dataclass(frozen=True, slots=True)
class Fastest:
    """A printer whose limits allow the pace and options that ask for it, and the prediction.

    trial: of the whole print, on the model and on the drawn printers that decide.
    """

    printer: Printer
    options: Options
    bound: Bound
    trial: Trial
    original: Original


def hastened(lines: Lines, printer: Printer, options: Options) -> Fastest:
    """How a print is made as fast as ``options.speed`` asks for. Raises HframeError."""
    asked, limits = options.speed, printer.limits
    assert asked is not None
    errors = asked.max_error
    bound = Bound(
        errors.get("", max(errors.values())),
        {name: error for name, error in errors.items() if name},
        cast(Measure, asked.error_measure),
    )
    freedom = Freedom(
        asked.speed_up, limits.filament_velocity, limits.min_layer_time,
        asked.filament_acceleration or math.inf,
    )  # fmt: skip
    drawn = draws(printer.plant, asked.model_error, DRAWS if asked.model_error else 0, SEED)
    found = fastest(lines, printer, options, bound, freedom, tuple(drawn))
    release_memory()
    return found


@one_blas_thread()
def fastest(
    lines: Lines,
    printer: Printer,
    options: Options,
    bound: Bound,
    freedom: Freedom = AS_IT_IS,
    drawn: tuple[Plant, ...] = (),
) -> Fastest:
    """How to print it in the least time within the bound. Raises HframeError.

    lines: gives the file's lines anew at each call. drawn: printers on which the bound must hold
    too.
    """
    drive = Drive(lines, printer, options, bound.measure, freedom)
    original = drive.original()
    cooling = Cooling.of(original, freedom)
    driven, plants = Pieces(drive, bound, (printer.plant, *drawn), freedom.speed_up).quickest()
    driven = cooling.planned(drive, driven)
    trial = _within(drive, bound, driven, plants, cooling, options.clamp)
    return Fastest(*drive.settings(trial.driven), bound, trial, original)


def _within(
    drive: Drive, bound: Bound, driven: Driven, plants: tuple[Plant, ...], cooling: Cooling,
    may_clamp: bool,
) -> Trial:  # fmt: skip
    """The quickest of a few trials of the whole print within the bound. Raises HframeError."""
    good, aims = list[Trial](), dict[str, float]()
    for number in range(1, MOST_ROUNDS + 1):
        trial = drive.of_all(driven, plants)
        shares, short = bound.shares(trial), cooling.short(trial.layers)
        allowed = HOLDS if number < MOST_ROUNDS else 1.0
        keeps = all(share <= allowed for share in shares.values())
        outruns = trial.clamped > 0 and not may_clamp and number < MOST_ROUNDS
        if trial.refused:
            driven = gentler(driven)
            continue
        if keeps and not short and not outruns:
            good.append(trial)
        if good and (number >= ROUNDS or spent(trial, shares, drive.top)):
            return min(good, key=lambda t: t.seconds)
        if not (keeps and short):  # what is driven harder would make other layers short
            gains = _gains(shares, aims)
            driven = slower(harder(driven, gains, drive.top), gains)
        if outruns:
            driven = milder(driven) if number < ROUNDS else gentler(driven)
        driven = cooling.planned(drive, cooling.slowed(driven, trial.layers))
    if trial.refused:
        raise HframeError(trial.refused)
    worst = max(shares, key=lambda name: shares[name])
    raise HframeError(
        f"no pace keeps this print within that error: {worst} is off by "
        f"{max(trial.errors[worst]) * 1e3:.0f} µm however gently it is printed, model error "
        "included; allow more"
    )


def _gains(shares: dict[str, float], aims: dict[str, float]) -> dict[str, float]:
    """Times its acceleration with which each kind should use up its bound.

    aims: by kind, of those that were beyond it; lowered with each time.
    """
    aims.update({k: SAFER * aims.get(k, AIM) for k, share in shares.items() if share > HOLDS})
    return {
        name: aims[name] / share if share > HOLDS
        else 1.0 if share > NEAR or name in aims
        else AIM / max(share, TINY)
        for name, share in shares.items()
    }  # fmt: skip


def spent(trial: Trial, shares: dict[str, float], top: float) -> bool:
    """Whether harder driving would gain next to nothing."""
    if trial.held_by["error"] < HARDLY * trial.seconds:
        return max(shares.values(), default=0.0) <= HOLDS
    own = trial.driven.acceleration
    return all(NEAR <= share <= HOLDS or (share <= HOLDS and own[name] >= top)
               for name, share in shares.items())  # fmt: skip
