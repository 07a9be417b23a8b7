import math
from functools import partial

import sequences
import torch

from diffrender.antialiasing import history
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames, bilinear, clamped
from diffrender.parameters import defaults

SETTINGS = defaults(AntiAliasing, torch.float64)
PICTURE = sequences.noise(0, 6, 8)
REST = torch.zeros(6, 8, 2, dtype=torch.float64)
UNKNOWN = torch.full_like(REST, math.nan)


def before(motion, then=REST, picture=PICTURE):
    return history.reprojected(partial(bilinear, picture, address=clamped), then, motion)


def test_motion_of_half_the_size_moves_every_pixel_of_its_block():
    half = sequences.noise(1, 3, 4)[..., :2]
    whole = history.motion_of(Frames(PICTURE, half, None), (6, 8))
    assert torch.equal(whole, half.repeat_interleave(2, 0).repeat_interleave(2, 1))


def test_missing_motion_is_unknown():
    assert bool(history.motion_of(Frames(PICTURE, None, None), (6, 8)).isnan().all())


def test_edges_move_with_the_nearest_surface():
    motion, depth = REST.clone(), torch.full((6, 8), 9.0, dtype=torch.float64)
    motion[2, 3], depth[2, 3] = torch.tensor([5.0, -1.0]).double(), 1.0
    found = history.motion_of(Frames(PICTURE, motion, depth), (6, 8))
    is_moved = (found == motion[2, 3]).all(-1)
    assert is_moved.nonzero().tolist() == [[y, x] for y in (1, 2, 3) for x in (2, 3, 4)]


def test_motion_leads_to_where_the_surface_was():
    motion = torch.tensor([2.0, 1.0], dtype=torch.float64).expand(6, 8, 2)
    found = before(motion)
    assert torch.equal(found.colour[:5, :6], PICTURE[1:, 2:])
    assert found.is_on_screen.nonzero().tolist() == [[y, x] for y in range(5) for x in range(6)]


def test_surfaces_are_the_same_where_both_frames_know_their_motion_and_agree():
    assert bool(before(REST).is_same_surface.all())
    assert not bool(before(REST, then=REST + 0.6).is_same_surface.any())
    assert not bool(before(UNKNOWN).is_same_surface.any())
    assert not bool(before(REST, then=UNKNOWN).is_same_surface.any())


def test_a_colour_within_those_around_is_accepted_and_one_outside_by_the_tolerance_at_most():
    grey = torch.full((6, 8, 3), 0.5, dtype=torch.float64)
    for apart, is_used in ((0.0, 1.0), (0.019, 1.0), (0.021, 0.0), (-0.3, 0.0)):
        found = history.accept(SETTINGS, grey, before(UNKNOWN, picture=grey + apart))
        assert bool((found == is_used).all())
    assert bool((history.accept(SETTINGS, grey, before(REST, picture=grey - 0.3)) == 1.0).all())


def test_a_detail_that_one_frame_met_is_accepted_in_both_orders():
    detail = torch.full((6, 8, 3), 0.5, dtype=torch.float64)
    grey = detail.clone()
    detail[3, 4] = 0.9
    assert bool((history.accept(SETTINGS, grey, before(UNKNOWN, picture=detail)) == 1.0).all())
    assert bool((history.accept(SETTINGS, detail, before(UNKNOWN, picture=grey)) == 1.0).all())


def test_what_was_off_screen_is_not_accepted():
    away = torch.tensor([9.0, 0.0], dtype=torch.float64).expand(6, 8, 2)
    assert not bool(history.accept(SETTINGS, PICTURE, before(away, then=away)).any())


def test_soft_acceptance_becomes_the_hard_one():
    other = PICTURE + 0.05 * sequences.noise(3, 6, 8)
    for known in (REST, UNKNOWN):
        hard = history.accept(SETTINGS, PICTURE, before(known, picture=other))
        soft = history.accept_softly(SETTINGS, PICTURE, before(known, picture=other), softness=1e-6)
        torch.testing.assert_close(soft, hard, rtol=0.0, atol=1e-6)
