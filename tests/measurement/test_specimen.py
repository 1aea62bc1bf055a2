import pytest

from benchmarks.specimen import MICRON, differences


def test_a_real_specimen_under_load_moves_as_another_program_measures(shared):
    folder = shared / "data" / "d_specimen"
    if not folder.is_dir():
        pytest.skip("needs the images of the specimen")
    _, found = differences(folder, loads=(1, 5))
    assert [each.load for each in found] == [1, 5]
    for each in found:
        assert each.points > 100
        assert each.plane < 3 * MICRON
        assert each.z < 8 * MICRON
    # the load is seen at all
    assert found[1].moved[2] < 5 * found[0].moved[2] < 0
