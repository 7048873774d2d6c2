"""Responses that change along x, from recordings at several places.

An axis has the response of each place. Racking is seen by its lever arm at several places at once,
so what was measured there is first moved to common frequencies, by the factors of x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.estimation.axes import Fit, begun, fit_known_start
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    advanced,
    average,
    lowest,
)
from hframe_post.model.impulse_response import (
    MOST_PLACES,
    Elsewhere,
    ImpulseResponse,
)

SAME_PLACE = 5.0  # mm
FACTORS = np.exp(np.arange(-0.35, 0.3501, 0.005))  # of frequencies, that are tried
DIGITS = 4  # of factors
LEAST_ARM = 20.0  # mm; nearer to x_c, racking does not tell its size

Places = Sequence[tuple[float, FrequencyResponse]]


def fit_places(found: Fit, places: Places) -> Fit:
    """Return the fit of the middle place, whose response knows those of the others.

    found: the fit of all of them together. places: x (mm) and what was measured there, its start
    known up to the recording's delay in ``found``. Raises IdentificationError.
    """
    at = _together(places)
    middle = min(at, key=lambda x: (abs(x - (min(at) + max(at)) / 2.0), x))
    fits = {
        x: fit_known_start(advanced(response, found.recording_delay)) for x, response in at.items()
    }
    own = fits[middle].G
    elsewhere = [
        Elsewhere(x, _frequency(own, one.G), one.G) for x, one in fits.items() if x != middle
    ]
    G = replace(own, x=middle, elsewhere=tuple(elsewhere))
    return begun(replace(fits[middle], G=G), found.recording_delay)


def factor(G: ImpulseResponse, place: float) -> float:
    """Return the frequencies at a place (mm), relative to those at the response's own."""
    if not G.elsewhere:
        return 1.0
    known = sorted([(G.x, 1.0), *((one.x, one.frequency) for one in G.elsewhere)])
    x, frequency = zip(*known, strict=True)
    return float(np.interp(place, x, frequency))


def at_common_frequencies(
    response: FrequencyResponse, G: ImpulseResponse, place: float
) -> FrequencyResponse:
    """Return the response at a place (mm) as it would be where G itself holds.

    The frequencies are those that are known of all places.
    """
    by, every = factor(G, place), [1.0, *(one.frequency for one in G.elsewhere)]
    hz = response.hz
    hz = hz[(hz * min(every) >= hz[0]) & (hz * max(every) <= hz[-1])]

    def there(values: Array) -> Array:
        return np.asarray(np.interp(hz * by, response.hz, values))

    H = there(response.H.real) + 1j * there(response.H.imag)
    coherence, power = there(response.coherence), there(response.power)
    return replace(response, hz=hz, H=H, coherence=coherence, power=power)


def racking_along_x(
    racking: ImpulseResponse,
    along: ImpulseResponse,
    slope: FrequencyResponse,
    measured: Sequence[tuple[float, float, FrequencyResponse]],
) -> ImpulseResponse:
    """Return racking that changes along x as the response along it does, ``along``.

    Its frequencies have the same factors, and its size is that which was measured. slope: what
    ``racking`` is the model of. measured: place and lever arm (mm), and what the nozzle did in y,
    at common frequencies.
    """
    own = replace(racking, x=along.x)
    power = float((slope.power * np.abs(slope.H) ** 2).sum())
    elsewhere: list[Elsewhere] = []
    for place, arm, response in measured:
        taken = [own.x, *(one.x for one in elsewhere)]
        if abs(arm) < LEAST_ARM or min(abs(place - x) for x in taken) < SAME_PLACE:
            continue
        size = float((slope.power * slope.H.conj() * response.H).sum().real) / (power * arm)
        frequency = factor(along, place)
        there = own.stretched(1.0 / frequency)
        there = replace(there, deviation=size * there.deviation, lag=size * own.lag)
        elsewhere.append(Elsewhere(round(place, 2), round(frequency, DIGITS), there))
    return replace(own, elsewhere=tuple(elsewhere))


def _together(places: Places) -> dict[float, FrequencyResponse]:
    """Return the mean response at each place (mm), of as many as a profile holds."""
    groups: dict[float, list[FrequencyResponse]] = {}
    for place, response in sorted(places, key=lambda one: one[0]):
        near = [x for x in groups if abs(x - place) < SAME_PLACE]
        groups.setdefault(near[0] if near else round(float(place), 2), []).append(response)
    every = -(-len(groups) // MOST_PLACES)
    return {x: average(each) for x, each in list(groups.items())[::every]}


def _frequency(G: ImpulseResponse, there: ImpulseResponse) -> float:
    """Return the factor of the frequencies that makes G most like the response at another place.

    Deviations are displacements, so what moves a print most counts most.
    """
    left = [_off(G.stretched(1.0 / factor), there) for factor in FACTORS.tolist()]
    return round(float(np.exp(lowest(np.log(FACTORS), left))), DIGITS)


def _off(one: ImpulseResponse, other: ImpulseResponse) -> float:
    """Return the sum of squares of the difference of two deviations."""
    lead = max(one.lead, other.lead)
    first, second = (np.pad(G.deviation, (lead - G.lead, 0)) for G in (one, other))
    n = max(len(first), len(second))
    first, second = (np.pad(q, (0, n - len(q))) for q in (first, second))
    return float(np.square(first - second).sum())
