"""The modes of a profile's transfer function, and what is expected of them after a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Flags
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.fit import RINGS
from hframe_post.identification.fitting.modal import Data, Modal, Parameters, Structure, refine
from hframe_post.identification.responses.frequency_response import EXACT
from hframe_post.model.transfer_function import TransferFunction, upper_and_real

BAND_HZ = (2.0, 120.0)  # in which the modes must give the transfer function
ALIKE = 0.01  # relative difference of both
DELAY = 0.4  # a real pole below is part of a delay
# standard deviations of a printer's change: of frequency and damping ratio, relative, and of a
# mode's contribution, as a share of the largest
CHANGE_HZ, CHANGE_DAMPING, CHANGE_SHARE = 0.05, 0.3, 0.05
HELD = 0.01  # share of these by which a mode may change that no recording can move


def known_modes(G: TransferFunction) -> list[float]:
    """Return the frequencies (Hz) of the modes that ring, within BAND_HZ."""
    s = np.log(upper_and_real(G.poles)[0]) / TS
    rings = -s.real < RINGS * np.abs(s)
    hz = np.abs(s[rings]) / (2.0 * np.pi)
    return sorted(hz[hz < BAND_HZ[1]].tolist())


def as_modes(G: TransferFunction) -> Modal:
    """Return a transfer function that `identify` found as the modes that it was made of.

    Raises IdentificationError if it is not a sum of modes behind a delay.
    """
    upper, real = upper_and_real(G.poles)
    lags = real[real.real > DELAY].real
    s, corners = np.log(upper) / TS, -np.log(lags) / TS
    structure = Structure(len(s), True, len(lags))
    delay = (G.order - structure.order) * TS
    start = Parameters(np.abs(s), -s.real / np.abs(s), corners, delay)
    hz = np.linspace(*BAND_HZ, 400)
    H = G.response(2.0 * np.pi * TS * hz)
    weight = 1.0 / np.hypot(0.01 * np.abs(H), 0.002 * np.abs(H).max())
    data = Data(hz, H, weight, (0.1, 450.0), (-2.0 * TS, delay + 2.0 * TS), EXACT)
    found = refine(data, structure, start)
    off = np.linalg.norm(found.response(hz) - H) / np.linalg.norm(H)
    if not off < ALIKE:
        raise IdentificationError(
            "the model in this profile is not a sum of modes as 'hframe-post identify' writes it, "
            "so none can be moved. Identify the printer again"
        )
    return found


@dataclass(frozen=True, slots=True)
class Known:
    """The model of an earlier day, from which modes move no farther than printers change.

    The sensor's gain is not part of it. held (modes,): whether a mode stays where it is.
    """

    model: Modal
    held: Flags

    def rows(self, structure: Structure, parameters: Parameters) -> tuple[Array, Array]:
        """Return rows (r, coefficients) and what they give (r,) for an unchanged printer."""
        old, before = self.model.coefficients, self.model.parameters
        along = np.outer(old, old) / (old @ old)
        often = np.ones(len(old))
        n, by_mode = structure.modes, np.where(self.held, 1.0 / HELD, 1.0)
        often[:n] = by_mode
        if structure.speed:
            often[n : 2 * n] = by_mode
        shares = (np.eye(len(old)) - along) * often[:, None] / (CHANGE_SHARE * np.abs(old).max())
        moved = np.concatenate([
            np.log(parameters.omega / before.omega) / CHANGE_HZ * by_mode,
            np.log(parameters.zeta / before.zeta) / CHANGE_DAMPING * by_mode,
            np.log(parameters.corner / before.corner) / CHANGE_HZ,
        ])  # fmt: skip
        rows = np.vstack([shares, np.zeros((len(moved), len(old)))])
        return rows, np.concatenate([np.zeros(len(old)), moved])
