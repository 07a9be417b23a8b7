"""About how near a smooth sky comes to a photo: E3 of free spherical harmonics up to order 4 of log radiance.

25 coefficients a channel, found by least squares over the masked solid angle; no physics, no sun. What is left over
is clouds, noise, and the steep glow round the sun, by which a good sky can come nearer than these.
"""

from collections.abc import Sequence

import numpy as np

from experiments import records, shots
from experiments.log_error import Floats, LogError, Mask, Sky, log_error, read_mask, read_picture, sky_under
from experiments.shots import Shot

ORDER = 4


def directions(mask: Mask) -> Floats:
    """Unit direction of each masked pixel: x ahead, y to the left, z up."""
    height, width = mask.shape
    rows, columns = np.nonzero(mask)
    from_zenith = np.pi * (rows + 0.5) / height
    azimuth = np.pi * (1.0 - 2.0 * (columns + 0.5) / width)
    level = np.sin(from_zenith)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.cos(from_zenith)], -1)


def basis(direction: Floats, order: int) -> Floats:
    """Functions that span the spherical harmonics up to an order, (order + 1)^2 columns.

    They are the monomials of degree `order` and of one less: on the unit sphere each lower one is a sum of these,
    for x^2 + y^2 + z^2 = 1.

    >>> basis(np.eye(3), order=4).shape
    (3, 25)
    """
    x, y, z = direction.T
    return np.stack(
        [
            x**i * y**j * z ** (degree - i - j)
            for degree in (order - 1, order)
            for i in range(degree + 1)
            for j in range(degree + 1 - i)
        ],
        -1,
    )


def harmonics_floor(sky: Sky) -> LogError:
    """E3 of the harmonics that fit a sky best."""
    functions = basis(directions(sky.mask), ORDER)
    root = np.sqrt(sky.weight)[:, None]
    coefficients = np.linalg.lstsq(functions * root, sky.log_radiance * root, rcond=None)[0]
    fitted = np.zeros((*sky.mask.shape, 3))
    fitted[sky.mask] = np.exp(functions @ coefficients) - sky.eps
    return log_error(sky, fitted)


def floor_of(shot: Shot) -> float:
    """E3 of the harmonics on a photo, by the peers' eps."""
    return harmonics_floor(sky_under(read_mask(shot.mask), read_picture(shot.photo), shot.eps)).error


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the floor of each photo, beside the better peer."""
    given = shots.ask("floor of smooth skies", arguments)
    floors = [
        {"photo": shot.name, "floor": floor, "peer": shot.peer_error, "ratio": floor / shot.peer_error}
        for shot in given.shots
        for floor in [floor_of(shot)]
    ]
    lines = [[str(row["photo"]), *(f"{row[name]:.5f}" for name in ("floor", "peer", "ratio"))] for row in floors]
    print(records.table(["photo", "floor E3", "better peer E3", "ratio"], lines))
    records.write(given.out / "harmonics_floor.json", {"order": ORDER, "records": floors})


if __name__ == "__main__":
    main()
