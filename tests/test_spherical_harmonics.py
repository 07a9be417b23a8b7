import math

import torch

from diffrender.rays import from_angles
from diffrender.spherical_harmonics import BANDS, basis


def test_the_nine_are_orthonormal_over_the_sphere():
    height = torch.tensor(
        [-0.9324695142031521, -0.6612093864662645, -0.2386191860831969]
    )  # Gauss and Legendre, 6 nodes
    weight = torch.tensor([0.1713244923791704, 0.3607615730481386, 0.4679139345726910], dtype=torch.float64)
    height, weight = torch.cat([height, -height]).double(), torch.cat([weight, weight])
    turn = torch.arange(8, dtype=torch.float64) * (math.pi / 4.0)
    elevation, azimuth = torch.meshgrid(torch.asin(height), turn, indexing="ij")
    found = basis(from_angles(elevation, azimuth))
    products = torch.einsum("ij,ijk,ijl->kl", weight[:, None].expand(6, 8) * (math.pi / 4.0), found, found)
    torch.testing.assert_close(products, torch.eye(9, dtype=torch.float64), rtol=0.0, atol=1e-6)


def test_every_coefficient_has_its_band():
    assert [BANDS[:count].count(band) for band, count in enumerate((1, 4, 9))] == [1, 3, 5]
    turned = basis(-from_angles(torch.tensor(0.3), torch.tensor(1.0)))
    signs = torch.tensor([(-1.0) ** band for band in BANDS])
    torch.testing.assert_close(turned, signs * basis(from_angles(torch.tensor(0.3), torch.tensor(1.0))))
