"""The peer: Mitsuba 3's sunsky (Hosek-Wilkie) fitted to a photo's log radiance by L-BFGS-B from three starts.

Free are turbidity, ground albedo and a gain per channel, 7 numbers; the sun stands at its given place. The loss is E3
with its gains among the unknowns, over all masked pixels of 512 x 256; gradients are Dr.Jit's, in reverse. It runs in
a process of its own (`python -m experiments.mitsuba_sky`), for Dr.Jit brings its own threads, and ends the process
where it finds an LLVM that it cannot use.
"""

import argparse
import importlib
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from experiments.harmonics_floor import directions
from experiments.log_error import Floats, Sky, log_error, read_mask, read_picture, sky_under
from experiments.timing import THREADS

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LIBRARIES = Path("/usr/lib")
LLVM_PLACES = ("llvm-19/lib/libLLVM*.so*", "*/libLLVM-19*.so", "*/libLLVM.so.19*")  # below it
STARTS = ((3.0, 0.3), (6.0, 0.1), (8.5, 0.6))  # turbidity and albedo
BOUNDS = [(1.0, 10.0), *[(0.0, 1.0)] * 3, *[(None, None)] * 3]  # of turbidity, albedo and the logarithms of the gains


@dataclass(frozen=True)
class PeerFit:
    """What the peer came to.

    Attributes:
        error: E3 of the best start, measured as that of every fit.
        seconds: all three starts, without import, reading, and the first value, which compiles.
        seconds_each: each start.
        compile_seconds: first value and gradient.
        evaluations: values with gradient, of all starts.
    """

    error: float
    seconds: float
    seconds_each: tuple[float, ...]
    compile_seconds: float
    evaluations: int
    turbidity: float
    albedo: tuple[float, ...]
    gains: tuple[float, ...]


@dataclass(frozen=True)
class Hosek:
    """Mitsuba's sky over the directions of the masked pixels, in the form that Dr.Jit evaluates."""

    mitsuba: Any
    drjit: Any
    emitter: Any
    parameters: Any
    seen: Any
    weight: Any
    wanted: tuple[Any, ...]
    eps: float

    def numbers(self, values: Floats) -> list[Any]:
        """Values as variables of Dr.Jit's kernels.

        Opaque, else each becomes a literal of the kernel, which then is compiled anew for every evaluation.
        """
        made = [self.mitsuba.Float(float(value)) for value in values]
        self.drjit.make_opaque(*made)
        return made

    def colours(self, turbidity: float, albedo: Sequence[float]) -> Floats:
        """Radiance of each pixel, one row each, not below 0."""
        made = self.numbers(np.array([turbidity, *albedo]))
        return np.maximum(np.array(self.radiance(made[0], made[1:]), dtype=np.float64).T, 0.0)

    def radiance(self, turbidity: Any, albedo: Sequence[Any]) -> Any:
        """Sky without its sun, three channels; turbidity and albedo as Dr.Jit's numbers."""
        self.parameters["turbidity"] = turbidity
        self.parameters["albedo.value"] = self.mitsuba.Color3f(*albedo)
        self.parameters.update()
        return self.emitter.eval(self.seen)

    def loss(self, point: Floats) -> tuple[float, Floats]:
        """E3 and its gradient at turbidity, albedo and logarithms of the gains."""
        drjit = self.drjit
        free = self.numbers(point)
        drjit.enable_grad(*free)
        radiance = self.radiance(free[0], free[1:4])
        squares = self.mitsuba.Float(0.0)
        for channel, log_gain, wanted in zip(range(3), free[4:], self.wanted, strict=True):
            gained = drjit.exp(log_gain) * drjit.maximum(radiance[channel], 0.0)
            squares += drjit.square(drjit.log(gained + self.eps) - wanted)
        loss = drjit.sum(self.weight * squares) / 3.0
        drjit.backward(loss)
        return float(loss[0]), np.array([float(drjit.grad(value)[0]) for value in free])


def find_llvm() -> str:
    """Shared library of LLVM 19: the one the environment names, else the first in the usual places.

    Raises:
        FileNotFoundError: when there is none.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return named
    found = [path for place in LLVM_PLACES for path in sorted(LIBRARIES.glob(place))]
    if not found:
        raise FileNotFoundError(f"no LLVM 19 below {LIBRARIES}; install libllvm19 or set {LLVM_VARIABLE}")
    return str(found[0])


def hosek(sky: Sky, sun: tuple[float, float]) -> Hosek:
    """Mitsuba's sky for the masked pixels of a photo, with the sun at an elevation and azimuth [degrees]."""
    os.environ[LLVM_VARIABLE] = find_llvm()  # read when drjit is imported
    mitsuba: Any = importlib.import_module("mitsuba")
    drjit: Any = importlib.import_module("drjit")
    mitsuba.set_variant("llvm_ad_rgb")
    drjit.set_thread_count(THREADS)
    elevation, to_right = np.radians(sun)
    to_sun = [np.cos(elevation) * np.cos(to_right), -np.cos(elevation) * np.sin(to_right), np.sin(elevation)]
    emitter = mitsuba.load_dict(
        {
            "type": "sunsky",
            "sun_direction": [float(value) for value in to_sun],
            "turbidity": STARTS[0][0],
            "albedo": {"type": "rgb", "value": [STARTS[0][1]] * 3},
            "sun_scale": 0.0,
        }
    )
    seen = drjit.zeros(mitsuba.SurfaceInteraction3f, len(sky.weight))
    seen.wi = mitsuba.Vector3f(-directions(sky.mask).T.astype(np.float32))
    wanted = tuple(mitsuba.Float(channel) for channel in sky.log_radiance.T.astype(np.float32))
    weight = mitsuba.Float(sky.weight.astype(np.float32))
    drjit.eval(seen, weight, *wanted)
    return Hosek(mitsuba, drjit, emitter, mitsuba.traverse(emitter), seen, weight, wanted, sky.eps)


def fit_hosek(sky: Sky, sun: tuple[float, float]) -> PeerFit:
    """Best of the fits from all starts, timed warm: the first evaluation, which compiles, is left out."""
    model = hosek(sky, sun)
    compile_seconds, _ = _timed(lambda: model.loss(_start(model, sky, *STARTS[0])))
    runs = [_timed(partial(_descend, model, sky, *start)) for start in STARTS]
    best = min((found for _, found in runs), key=lambda found: float(found.fun))
    fitted = np.zeros((*sky.mask.shape, 3))
    fitted[sky.mask] = model.colours(best.x[0], best.x[1:4])
    return PeerFit(
        error=log_error(sky, fitted).error,
        seconds=sum(seconds for seconds, _ in runs),
        seconds_each=tuple(seconds for seconds, _ in runs),
        compile_seconds=compile_seconds,
        evaluations=sum(int(found.nfev) for _, found in runs),
        turbidity=float(best.x[0]),
        albedo=tuple(map(float, best.x[1:4])),
        gains=tuple(map(float, np.exp(best.x[4:]))),
    )


def _start(model: Hosek, sky: Sky, turbidity: float, albedo: float) -> Floats:
    """Turbidity, albedo, and the gains that suit them on average."""
    radiance = model.colours(turbidity, [albedo] * 3)
    log_gains = sky.weight @ (sky.log_radiance - np.log(radiance + sky.eps))
    return np.array([turbidity, albedo, albedo, albedo, *log_gains])


def _descend(model: Hosek, sky: Sky, turbidity: float, albedo: float) -> Any:
    return minimize(model.loss, _start(model, sky, turbidity, albedo), jac=True, method="L-BFGS-B", bounds=BOUNDS)


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    found = work()
    return time.perf_counter() - began, found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the peer's fit as one line of JSON."""
    parser = argparse.ArgumentParser(description="fit of Mitsuba's sunsky")
    parser.add_argument("photo", type=Path)
    parser.add_argument("mask", type=Path)
    parser.add_argument("--sun", required=True, help="ELEVATION,AZIMUTH in degrees, to the right of the centre")
    parser.add_argument("--eps", type=float, required=True)
    given = parser.parse_args(arguments)
    elevation, to_right = map(float, given.sun.split(","))
    sky = sky_under(read_mask(given.mask), read_picture(given.photo), given.eps)
    print(json.dumps(asdict(fit_hosek(sky, (elevation, to_right)))))


if __name__ == "__main__":
    main()
