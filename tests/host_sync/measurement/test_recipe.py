"""Recipes: whole ones are read, others are refused with file, key and what is accepted."""

from pathlib import Path

import pytest

from host_sync.errors import MeasurementError
from host_sync.measurement.recipe import Recipe, checked, from_options, read_recipe
from host_sync.report.writing import read_template

WHOLE = """
name = "ground face"
coverage_factor = 2
region_um = [100, 100, 900, 800]
form = "polynomial-3"
s_filter_um = 10
l_filter_um = 800.0
parameters = ["height", "Sdq"]
smr_um = [0.5]
smc_percent = [10, 80]
spectrum = true
[scale]
pixel_pitch_share = 0.002
[[profile]]
name = "across"
from_um = [0, 100]
to_um = [900, 100]
l_filter_um = 250
[[step]]
name = "groove"
kind = "groove"
from_um = [0, 100]
to_um = [900, 100]
edges_um = [300, 600]
[[volume]]
name = "pit"
region_um = [100, 100, 300, 300]
border_um = 20
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "recipe.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_whole_recipe_is_read(tmp_path: Path) -> None:
    recipe = read_recipe(write(tmp_path, WHOLE))
    assert recipe.form == "polynomial-3"
    assert recipe.profile[0].sections == 5
    assert recipe.step[0].edges_um == (300.0, 600.0)
    assert recipe.scale.pixel_pitch_share == 0.002


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('form = "cone"', ("form", "'cone'", "none, mean, plane, sphere, polynomial-2")),
        ("coverage_factor = 3", ("coverage_factor", "accepted are 1, 2")),
        ("l_fliter_um = 3", ("l_fliter_um", "accepted keys are name, coverage_factor")),
        ('parameters = ["Sx"]', ("parameters", "'Sx'", "height, hybrid, spatial, functional, Sa")),
        ("s_filter_um = 30\nl_filter_um = 20", ("s_filter_um", "less than that")),
        ("l_filter_um = -1", ("l_filter_um: is out of range; accepted is a number above 0",)),
        ("l_filter_um = nan", ("l_filter_um",)),
        ('l_filter_um = "fine"', ("l_filter_um: is a text; accepted is a number or nothing",)),
        ("region_um = [1, 2]", ("region_um: is a list of 2; accepted is a list of 4",)),
        ("region_um = [0,5, 0,5, 9,5, 9,5]", ("is a list of 8; accepted is a list of 4: write decimal points",)),
        ('[angle]\nname = "a"', ("angle: is a table; accepted is a list: write [[angle]]",)),
        ('parameters = ["Ra"]', ("parameters: 'Ra' is unknown", "; a line's parameters come with [[profile]]")),
        ("spectrum = 1", ("spectrum: is a whole number; accepted is true or false",)),
        ("[[distance]]", ("distance[0]: name is missing",)),
        ('[[distance]]\nname = ""', ("distance[0].name: is too short; accepted is at least 1 characters",)),
        (
            '[[step]]\nname = "a"\nfrom_um = [0, 0]\nto_um = [9, 9]\nkind = "hole"',
            ("step", "'groove', 'ridge', 'step'"),
        ),
        ('[[profile]]\nname = "a"\nfrom_um = [0, 0]', ("profile", "to_um")),
        (
            '[[profile]]\nname = "a"\nfrom_um = [0, 0]\nto_um = [1, 1]\nwide = 3',
            ("wide", "keys are name, from_um"),
        ),
        ('[[step]]\nname = "a"\nfrom_um = [0, 0]\nto_um = [9, 9]\nedges_um = [3, 4]', ("edges_um", "a step has 1")),
        ("[scale]\npixel_pitch_share = -0.1", ("scale.pixel_pitch_share",)),
        (2 * '[[distance]]\nname = "a"\nfrom_um = [0, 0]\nto_um = [1, 1]\n', ("'a' occurs twice",)),
        ("smr_um = [nan]", ("smr_um",)),
        ("form = ", ("not TOML",)),
    ],
)
def test_others_are_refused_by_key(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(MeasurementError) as refused:
        read_recipe(write(tmp_path, text))
    assert "Expected" not in str(refused.value)
    assert "Object" not in str(refused.value)
    for word in ("recipe.toml", *words):
        assert word in str(refused.value)


def test_the_recipe_of_the_documents_is_whole() -> None:
    recipe = read_recipe(Path(__file__).parents[3] / "tests" / "benchmarks" / "measurement" / "recipe.toml")
    tables = (recipe.profile, recipe.step, recipe.distance, recipe.angle, recipe.radius, recipe.volume)
    assert all(len(table) == 1 for table in tables)


def test_a_missing_or_binary_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"none\.toml: cannot be read"):
        read_recipe(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MeasurementError, match=r"b\.toml"):
        read_recipe(tmp_path / "b.toml")


def test_advice_on_text_that_is_no_toml_ends_with_the_mend(tmp_path: Path) -> None:
    path = tmp_path / "smart.toml"
    path.write_text("parameters = [“Sa”]", encoding="utf-8")
    for reads in (read_recipe, read_template):
        with pytest.raises(MeasurementError, match=r'write straight quotes, "…"$'):
            reads(path)


def test_options_stand_in_for_keys_and_are_checked_as_they_are() -> None:
    recipe = from_options(Recipe(l_filter_um=80.0), {"form": "sphere", "region_um": (0.0, 0.0, 9.0, 9.0)})
    assert (recipe.form, recipe.l_filter_um, recipe.region_um) == ("sphere", 80.0, (0.0, 0.0, 9.0, 9.0))
    with pytest.raises(MeasurementError, match="s_filter_um"):
        from_options(Recipe(), {"s_filter_um": -3.0})
    with pytest.raises(MeasurementError, match="form"):
        checked(from_options(Recipe(), {"form": "cube"}), "options")
