"""Side by side, each nozzle moves as it does alone."""

import numpy as np
import pytest

from hframe_post.model.nozzle import Plants, Response
from hframe_post.printer.settings import Printer
from hframe_post.studies.uncertainty import draws
from tests.coupled import coupled_plant
from tests.paths import walk


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize(("plants", "commands"), [(1, 1), (1, 3), (2, 2), (7, 1)])
def test_side_by_side(paper: Printer, plants: int, commands: int, coupled: bool) -> None:
    own = coupled_plant(1, racks=True) if coupled else paper.plant
    drawn = (own, *draws(own, 0.1, plants - 1, seed=1))
    origin = np.array([200.0, 80.0])
    each = [origin + walk(np.random.default_rng(k), 1000) for k in range(commands)]
    together = Plants(drawn).at_rest(origin, commands, 0.0)
    cuts = ([xy[cut] for xy in each] for cut in (slice(0, 1), slice(1, 400), slice(400, None)))
    motion = np.concatenate([together.run(pieces) for pieces in cuts], axis=2)
    alone = [[Response(plant, origin).run(xy) for xy in each] for plant in drawn]
    assert motion.tobytes() == np.array(alone).tobytes()
