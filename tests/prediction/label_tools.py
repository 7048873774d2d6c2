"""Make samples with slicer comments and read back their labels."""

import numpy as np

from hframe_post.arrays import Array
from hframe_post.prediction.statistics import Labels
from hframe_post.stream.types import Dwell, Handling, ModalState, Passthrough, Samples
from tests.mark_tools import mark

STATE = ModalState(True, True, 0.0, 60.0, (0.0, 0.0, 0.0))
Named = tuple[list[str], list[str]]


def block(
    e: list[float] | Array, *comments: tuple[int, bytes], first: int = 0, paused: bool = False
) -> Samples:
    """Samples whose filament is e, with comments before samples: marks, or lines at rest."""
    xyze = np.zeros((len(e), 4))
    xyze[:, 3] = e
    events = tuple(
        Dwell(first + k, 0, Passthrough(1, text, Handling.REST, STATE))
        if paused
        else mark(first + k, text)
        for k, text in comments
    )
    return Samples(first, xyze, np.zeros(len(e), np.int64), events)


def names(blocks: list[Samples], labels: Labels | None = None) -> Named:
    """Layer and feature of each sample, by name."""
    labels = labels or Labels()
    layers: list[str] = []
    features: list[str] = []
    for each in blocks:
        layer, feature = labels.number(each)
        assert len(layer) == len(feature) == len(each)
        layers += [labels.layers[k] for k in layer]
        features += [labels.features[k] for k in feature]
    return layers, features


def printing(n: int) -> Array:
    """Filament of n samples that all extrude."""
    return np.arange(1.0, n + 1)
