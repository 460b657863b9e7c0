"""Uses what most tests use of the engine, so that it is compiled and kept on disk."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from nilbs.characters.capsule import capsule
from nilbs.characters.motion import random_motion
from nilbs.engine.winding import winding_number
from nilbs.models.fitting import fit

for d in (2, 3):
    c = capsule(d=d, resolution=8)
    model = fit(c, random_motion(c, frames=2), steps=0, cache_resolution=8, weight_resolution=8, device="cpu")
    posed = model.posed(model.motion[1])
    x = c.V[:5] + 0.01
    for query in (posed.posed_distance, posed.closest_points, posed.rest_points, posed.posed_points):
        query(x)
    model.extract(model.motion[1], 8)
    winding_number(c.V, c.F, x)
