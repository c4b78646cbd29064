import numpy as np

from host_sync.johnson2009.lookup_table import BANDWIDTH_FLOOR, MAX_CLUSTERS, cluster_bins


def clustered(*bins):
    return cluster_bins(np.concatenate(bins), np.cumsum([0, *map(len, bins)]))


def around(p, q, count, rng):
    return np.array([p, q]) + 0.01 * rng.standard_normal((count, 2))


def test_each_group_of_slopes_is_one_cluster_largest_first():
    rng = np.random.default_rng(0)
    one = around(0.5, 0.5, 12, rng)
    two = np.concatenate([around(0.8, 0.0, 10, rng), around(-0.8, 0.1, 30, rng)])
    centres, count = clustered(one, two)
    assert count.tolist() == [1, 2]
    np.testing.assert_allclose(centres[0, 0], one.mean(axis=0))
    np.testing.assert_allclose(centres[1, 0], two[10:].mean(axis=0))
    np.testing.assert_allclose(centres[1, 1], two[:10].mean(axis=0))


def test_a_long_sheet_of_slopes_is_not_cut():
    sheet = np.stack([np.linspace(-1.0, 1.0, 120), np.full(120, 0.4)], axis=-1)
    _, count = clustered(sheet)
    assert count.tolist() == [1]


def test_the_bandwidth_keeps_its_floor_at_the_flat():
    near = np.array([[0.0, 0.0], [0.4 * BANDWIDTH_FLOOR, 0.0]])
    far = np.array([[0.0, 0.0], [2.0 * BANDWIDTH_FLOOR, 0.0]])
    assert clustered(near, far)[1].tolist() == [1, 2]


def test_only_the_largest_clusters_are_kept():
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    groups = [np.repeat([[np.cos(a), np.sin(a)]], size, axis=0) for a, size in zip(angle, range(1, 7), strict=True)]
    centres, count = clustered(np.concatenate(groups))
    assert count.tolist() == [MAX_CLUSTERS]
    np.testing.assert_allclose(centres[0, 0], [np.cos(angle[5]), np.sin(angle[5])])


def test_a_crowded_bin_keeps_its_clusters():
    rng = np.random.default_rng(0)
    crowd = np.concatenate([around(0.8, 0.0, 2000, rng), around(-0.8, 0.0, 1500, rng)])
    centres, count = clustered(crowd)
    assert count.tolist() == [2]
    np.testing.assert_allclose(centres[0, :2], [[0.8, 0.0], [-0.8, 0.0]], atol=0.01)
