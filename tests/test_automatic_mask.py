import numpy as np

from experiments import automatic_mask


def test_overlap_is_that_of_the_masks_within_the_fair_domain():
    one, other = np.zeros((2, 4), dtype=bool), np.zeros((2, 4), dtype=bool)
    one[0, :3], other[0, 1:] = True, True
    assert automatic_mask.over_union(one, other) == 0.5
    assert automatic_mask.over_union(one & ~one, other & ~other) == 1.0
    fair = automatic_mask.fair_domain(180, (40.0, 90.0))
    assert fair[:85].mean() > 0.97
    assert not fair[86:].any()
    assert not fair[50, 270]
    assert fair[50, 90]
