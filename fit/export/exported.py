"""What a target makes of a weather: the files of a folder, and the account of them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from diffrender.rays import Equirectangular
from fit import picture
from fit.export.account import Account
from fit.export.described import Described
from fit.picture import Drawn

PANORAMA = Equirectangular(2048, 1024)


@dataclass(frozen=True, eq=False)
class Exported:
    """Files by name, and what they keep."""

    texts: Mapping[str, str]
    pictures: Mapping[str, Drawn]
    account: Account


def panorama(weather: Described) -> Drawn:
    """The whole sphere as a picture: the sky without the sun's disc, black below the horizon.

    Two rows below the horizon repeat the one above, so that no filter darkens it.
    """
    radiance = picture.draw(weather.scene, PANORAMA)["sky"]
    middle = PANORAMA.height // 2
    radiance[middle : middle + 2] = radiance[middle - 1]
    return {"sky": np.ascontiguousarray(radiance)}
