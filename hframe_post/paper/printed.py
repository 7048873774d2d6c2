"""Tables I and II as they are printed, and how far a model is from them."""

from __future__ import annotations

import numpy as np

from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction

# Tables I and II, descending powers of z without the cancelled root at the origin, with the
# two signs mended (b_2 of Gxx, a_4 of Gxθ). As text, for the number of their digits.
PRINTED = {
    "Gxx": ("0.07632 -0.231 0.236 -0.0813", "1 -3.577 4.774 -2.815 0.6175"),
    "Gxtheta": (
        "4.246 -29.27 87.51 -147 149.9 -92.76 32.26 -4.865",
        "1 -5.866 14.86 -21 17.83 -9.06 2.535 -0.2987",
    ),
    "Gyy": (
        "0.1646 -0.8951 1.975 -2.199 1.231 -0.2764",
        "1 -4.813 9.386 -9.344 4.845 -1.14 0.06512",
    ),
}
SIGNIFICANT = 4  # printed digits; trailing zeros were not printed


def coefficients_off(plant: Plant) -> dict[str, float]:
    """Largest distance of a coefficient from the printed one, in half units of its last digit.

    At most 1: the model is among those that the printed tables may mean.
    """
    off = {}
    for name, texts in PRINTED.items():
        G: TransferFunction = getattr(plant, name)
        gain = G.gain * (1e3 if name == "Gxtheta" else 1.0)  # rad/mm to rad/m
        worst = 0.0
        for text, roots, factor in zip(texts, (G.zeros, G.poles), (gain, 1.0), strict=True):
            printed = np.array(text.split(), dtype=float)
            digits = np.floor(np.log10(np.abs(printed))) + 1 - SIGNIFICANT
            ours = factor * np.poly(roots).real
            worst = max(worst, float((np.abs(ours - printed) / (0.5 * 10.0**digits)).max()))
        off[name] = worst
    return off
