import pytest
from explorer_cases import create_cube

from wavefield.commands.sources import find_cube
from wavefield.errors import WavefieldError
from wavefield.pipeline.catalog import catalog_add


@pytest.fixture
def catalog(tmp_path):
    for name in ("calm", "rough"):
        (tmp_path / f"{name}.yaml").write_text(
            f'name: {name}\nframe_rate: 20\ncameras: {{cam1: "{name}/{{frame}}.tif"}}\n'
        )
        catalog_add(tmp_path / "tank.yaml", tmp_path / f"{name}.yaml")
    return tmp_path / "tank.yaml"


def made(catalog, run):
    folder = catalog.with_suffix("") / run / "1a2b3c4d"
    folder.mkdir(parents=True)
    (folder.parent / "latest").symlink_to("1a2b3c4d")
    create_cube(folder / "cube.zarr", preview=False)
    return folder / "cube.zarr"


def test_a_run_of_a_catalog_is_opened_by_name(catalog):
    with pytest.raises(WavefieldError, match="no cube of any run yet; make it with `wavefield run"):
        find_cube(catalog)
    rough = made(catalog, "rough")
    assert find_cube(catalog).resolve() == rough
    calm = made(catalog, "calm")
    assert find_cube(catalog, "calm").resolve() == calm
    with pytest.raises(WavefieldError, match="cubes of calm, rough; name one"):
        find_cube(catalog)
    with pytest.raises(WavefieldError, match="no run 'wild'; it has calm, rough"):
        find_cube(catalog, "wild")
    with pytest.raises(WavefieldError, match="is no catalog: leave out 'calm'"):
        find_cube(calm, "calm")
