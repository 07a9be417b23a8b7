import math

import pytest
import torch

from diffrender import surfaces
from diffrender.colour import srgb_encode
from diffrender.surfaces import GBuffer, Surface, packed, unpacked

FLOAT = torch.float64


def of_normals(normal):
    grey = torch.full(normal.shape[:-1], 0.5, dtype=normal.dtype)
    return Surface(normal, grey[..., None].expand_as(normal), grey, grey)


def random_normals(count):
    return torch.nn.functional.normalize(
        torch.randn(count, 3, dtype=FLOAT, generator=torch.Generator().manual_seed(0)), dim=-1
    )


def angle_between(one, other):
    return torch.atan2(torch.linalg.vector_norm(torch.linalg.cross(one, other), dim=-1), (one * other).sum(-1))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_normals_are_kept_within_the_stated_angle_which_is_not_slack(dtype):
    normals = random_normals(200_000)
    kept = unpacked(packed(of_normals(normals.to(dtype))), FLOAT).normal
    largest = angle_between(kept, normals).max()
    assert 0.8 * surfaces.NORMAL_ERROR <= largest <= surfaces.NORMAL_ERROR


def test_axes_are_kept_as_they_are():
    axes = torch.cat([torch.eye(3, dtype=FLOAT), -torch.eye(3, dtype=FLOAT)])
    torch.testing.assert_close(unpacked(packed(of_normals(axes)), FLOAT).normal, axes, rtol=0.0, atol=0.0)


def test_base_roughness_and_metalness_are_kept_within_half_a_step():
    draw = torch.Generator().manual_seed(1)
    given = Surface(
        random_normals(10_000),
        torch.rand(10_000, 3, dtype=FLOAT, generator=draw),
        torch.rand(10_000, dtype=FLOAT, generator=draw),
        torch.rand(10_000, dtype=FLOAT, generator=draw),
    )
    kept = unpacked(packed(given), FLOAT)
    half = 0.5 / 255.0 * (1.0 + 1e-12)
    assert ((srgb_encode(kept.base) - srgb_encode(given.base)).abs() <= half).all()
    assert ((kept.roughness - given.roughness).abs() <= half).all()
    assert ((kept.metallic - given.metallic).abs() <= half).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_is_unpacked_packs_to_the_same_bytes(dtype):
    byte = torch.arange(256, dtype=torch.uint8)
    normal = packed(of_normals(random_normals(256 * 64))).normal.reshape(64, 256, 4)
    normal[..., 3] = byte
    buffer = GBuffer(torch.stack([byte, byte.flip(0), byte.roll(7), byte], -1).expand(64, 256, 4), normal)
    again = packed(unpacked(buffer, dtype))
    assert torch.equal(again.colour, buffer.colour)
    assert torch.equal(again.normal, buffer.normal)


def test_a_gbuffer_has_the_batch_shape_of_the_fields_together():
    shared = Surface(
        torch.tensor([0.0, 0.0, 1.0]).expand(5, 1, 3), torch.rand(4, 3), torch.tensor(0.5), torch.rand(5, 4)
    )
    buffer = packed(shared)
    assert buffer.colour.shape == buffer.normal.shape == (5, 4, 4)


@pytest.mark.parametrize("value", [-0.01, 1.01, math.nan])
@pytest.mark.parametrize("name", ["base", "roughness", "metallic"])
def test_what_bytes_cannot_hold_is_refused(name, value):
    given = vars(of_normals(random_normals(2)))
    given[name] = torch.full_like(given[name], value)
    with pytest.raises(ValueError, match=name):
        packed(Surface(**given))
