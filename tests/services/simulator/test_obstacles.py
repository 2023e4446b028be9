"""Boxes, poles and models: where they stand, that they carry and stop the vehicle, and files that can't be used."""

import base64
import json
import struct
from math import pi
from pathlib import Path

import numpy as np
import pytest

from jezero.base.config import ConfigError
from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.simulator import PlaceBody
from jezero.services.simulator.config import BoxConfig, ModelConfig, PoleConfig, SimulatorConfig, TerrainConfig
from jezero.services.simulator.obstacles import StandingObstacle, hidden, make_obstacles, obstacle_triangles
from jezero.services.simulator.rover import RoverModel
from jezero.services.simulator.terrain import make_terrain
from jezero.services.simulator.world import World
from tests.services.simulator.test_control import ControlBench

VEHICLE = VehicleConfig()
ZERO: Vec3 = (0.0, 0.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
FORWARD: Vec3 = (1.0, 0.0, 0.0)
LENS: Vec3 = (0.0, 0.0, 0.05)


def flat(**settings: object) -> TerrainConfig:
    return TerrainConfig(std_ground_m=0.0, craters=0, rocks=0, **settings)  # type: ignore[arg-type]


def standing(config: TerrainConfig) -> tuple[StandingObstacle, ...]:
    return make_obstacles(config, make_terrain(config))


def world_of(config: TerrainConfig) -> World:
    terrain = make_terrain(config)
    rover = RoverModel(SimulatorConfig().rover, terrain, VEHICLE.platform.height_m)
    return World(SimulatorConfig(terrain=config), VEHICLE, terrain, rover.state, make_obstacles(config, terrain))


HUT = BoxConfig(north_m=10.0, east_m=4.0, size_m=(4.0, 2.0, 3.0))


def test_a_box_is_as_long_wide_and_high_as_it_says_and_turns_clockwise() -> None:
    (hut,) = standing(flat(boxes=(HUT,)))
    least_m, most_m = hut.limits_ned_m
    assert least_m == pytest.approx((8.0, 3.0, -3.0))
    assert most_m[:2] == pytest.approx((12.0, 5.0))
    turned = BoxConfig(north_m=10.0, east_m=4.0, size_m=(4.0, 0.01, 3.0), yaw_rad=0.25 * pi)
    (turned_box,) = standing(flat(boxes=(turned,)))
    north_east = turned_box.corners_ned_m[turned_box.corners_ned_m[:, 0].argmax()]
    assert north_east[:2] == pytest.approx((10.0 + 2.0 * 0.7071, 4.0 + 2.0 * 0.7071), abs=0.01)


def test_what_stands_on_a_slope_stands_on_its_ground() -> None:
    config = flat(slope_deg=10.0, poles=(PoleConfig(north_m=-8.0, east_m=0.0, length_m=5.0),))
    ground_m = make_terrain(config).height_m(-8.0, 0.0)
    assert ground_m > 0.5
    (pole,) = standing(config)
    assert -pole.limits_ned_m[0][2] == pytest.approx(ground_m + 5.0, abs=1e-4)
    assert -pole.limits_ned_m[1][2] < ground_m


def test_a_box_carries_the_vehicle_and_the_beam_measures_its_top() -> None:
    world = world_of(flat(boxes=(HUT,)))
    world.place_uav((10.0, 4.0, -6.0), 0.0)
    assert world.range_m(LENS, DOWN, 10.0) == pytest.approx(2.95, abs=0.003)
    world.place_uav((10.0, 4.0, -3.3), 0.0)
    for _ in range(500):
        world.step(ZERO, ZERO)
    assert -world.state.pos_ned_m[2] == pytest.approx(3.0 + VEHICLE.airframe.height_stand_m, abs=0.02)
    world.close()


def test_water_reflects_the_beam_and_what_stands_in_it_too() -> None:
    pile = BoxConfig(north_m=10.0, east_m=4.0, size_m=(1.0, 1.0, 5.0))
    world = world_of(flat(water_depth_m=3.0, boxes=(pile,)))
    world.place_uav((20.0, 0.0, -4.0), 0.0)
    assert world.range_m(LENS, DOWN, 10.0) == pytest.approx(3.95, abs=0.003)
    world.place_uav((10.0, 4.0, -4.0), 0.0)
    assert world.range_m(LENS, DOWN, 10.0) == pytest.approx(1.95, abs=0.003)
    world.close()


def test_a_pole_stops_a_vehicle_that_flies_against_it() -> None:
    weight_n = VEHICLE.airframe.mass_kg * 9.81
    reached_m = []
    for poles in ((), (PoleConfig(north_m=8.0, east_m=0.0, length_m=6.0, radius_m=0.1),)):
        world = world_of(flat(poles=poles))
        world.place_uav((5.0, 0.0, -3.0), 0.0, vel_ned_mps=(3.0, 0.0, 0.0))
        for _ in range(500):
            world.step((0.0, 0.0, -weight_n), ZERO)
        reached_m.append(world.state.pos_ned_m[0])
        world.close()
    free_m, stopped_m = reached_m
    assert free_m == pytest.approx(11.0, abs=0.1)
    assert stopped_m < 8.0


def test_the_vehicle_does_not_start_in_an_obstacle() -> None:
    for boxes in (
        (BoxConfig(north_m=0.5, east_m=0.0, size_m=(1.0, 1.0, 1.0)),),
        (BoxConfig(north_m=0.0, east_m=0.0, size_m=(20.0, 20.0, 20.0)),),
    ):
        with pytest.raises(ConfigError, match=r"box 1 .* is where the vehicle starts: move it"):
            world_of(flat(boxes=boxes))
    roof = BoxConfig(north_m=0.0, east_m=0.0, size_m=(5.0, 5.0, 0.2), height_m=3.0)
    world_of(flat(boxes=(roof,))).close()


def test_nothing_is_put_into_an_obstacle_but_the_vehicle_may_be_put_above_one() -> None:
    bench = ControlBench(SimulatorConfig(terrain=flat(boxes=(HUT,))))
    assert "box 1 is there" in bench.refuses(PlaceBody(north_m=11.0, east_m=4.5))
    assert "box 1 is there" in bench.refuses(PlaceBody(what="rover", north_m=7.5, east_m=4.0))
    bench.does(PlaceBody(what="rover", north_m=20.0, east_m=4.0))
    bench.climb()
    state = bench.does(PlaceBody(north_m=10.0, east_m=4.0, height_m=6.0))
    assert [each.name for each in state.obstacles] == ["box 1"]
    (hut,) = state.obstacles
    assert hut.pos_foot_ned_m == pytest.approx((10.0, 4.0, 0.0), abs=0.01)
    assert hut.size_ned_m == pytest.approx((4.0, 2.0, 3.0))
    bench.simulator.close()


def test_a_wall_hides_what_is_behind_it_and_nothing_else() -> None:
    wall = obstacle_triangles(flat(boxes=(BoxConfig(north_m=5.0, east_m=0.0, size_m=(0.2, 2.0, 2.0)),)))
    eye = np.array((0.0, 0.0, -1.0))
    points = np.array([(10.0, 0.0, -1.0), (10.0, 5.0, -1.0), (10.0, 0.0, -5.0), (4.0, 0.0, -1.0), (-3.0, 0.0, -1.0)])
    assert hidden(wall, eye, points).tolist() == [True, False, False, False, False]


# -- models ----------------------------------------------------------------------------------------------

ARROW = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 3.0)], dtype="<f4")
"""Corners of a tetrahedron that is 2 long in x, 1 in y and 3 in z."""
SIDES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], dtype="<u2")


def gltf(colour: list[float]) -> str:
    """A glTF 2.0 file of the tetrahedron, by the specification."""
    data = SIDES.tobytes() + ARROW.tobytes()
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}}],
            "buffers": [
                {
                    "byteLength": len(data),
                    "uri": f"data:application/octet-stream;base64,{base64.b64encode(data).decode()}",
                }
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": SIDES.nbytes},
                {"buffer": 0, "byteOffset": SIDES.nbytes, "byteLength": ARROW.nbytes},
            ],
            "accessors": [
                {"bufferView": 0, "componentType": 5123, "count": SIDES.size, "type": "SCALAR"},
                {
                    "bufferView": 1,
                    "componentType": 5126,
                    "count": len(ARROW),
                    "type": "VEC3",
                    "min": ARROW.min(axis=0).tolist(),
                    "max": ARROW.max(axis=0).tolist(),
                },
            ],
        }
    )


def obj() -> str:
    corners = "\n".join("v {} {} {}".format(*corner) for corner in ARROW.tolist())
    return corners + "\n" + "\n".join("f {} {} {}".format(*(side + 1)) for side in SIDES)


def stl() -> bytes:
    faces = b"".join(struct.pack("<12fH", 0, 0, 0, *ARROW[side].ravel(), 0) for side in SIDES)
    return bytes(80) + struct.pack("<I", len(SIDES)) + faces


@pytest.fixture
def models(tmp_path: Path) -> Path:
    (tmp_path / "arrow.gltf").write_text(gltf([1.0, 0.0, 0.0]))
    (tmp_path / "arrow.obj").write_text(obj())
    (tmp_path / "arrow.stl").write_bytes(stl())
    return tmp_path


def model(file: Path, **settings: float) -> StandingObstacle:
    config = flat(models=(ModelConfig(file=str(file), north_m=10.0, east_m=0.0, **settings),))  # type: ignore[arg-type]
    (found,) = standing(config)
    return found


def test_a_model_stands_upright_and_its_front_points_north(models: Path) -> None:
    """In glTF and OBJ y is up and z is the front. In STL z is up and x is the front."""
    for file in ("arrow.gltf", "arrow.obj"):
        found = model(models / file)
        assert found.name == f"model 1 ({file})"
        least_m, most_m = found.limits_ned_m
        assert least_m == pytest.approx((10.0, -2.0, -1.0))
        assert most_m == pytest.approx((13.0, 0.0, 0.0))
    least_m, most_m = model(models / "arrow.stl").limits_ned_m
    assert least_m == pytest.approx((10.0, -1.0, -3.0))
    assert most_m == pytest.approx((12.0, 0.0, 0.0))


def test_a_model_is_turned_scaled_and_lifted(models: Path) -> None:
    least_m, most_m = model(models / "arrow.stl", yaw_rad=0.5 * pi, scale=0.5, height_m=1.0).limits_ned_m
    assert least_m == pytest.approx((10.0, 0.0, -2.5), abs=1e-6)
    assert most_m == pytest.approx((10.5, 1.0, -1.0), abs=1e-6)


def test_a_model_has_the_colour_of_its_file_or_that_of_the_setting(models: Path) -> None:
    assert model(models / "arrow.gltf").mesh[:, 6:9].mean(axis=0) == pytest.approx((1.0, 0.0, 0.0), abs=0.01)
    config = ModelConfig(file=str(models / "arrow.stl"), north_m=10.0, east_m=0.0, colour=(0.0, 0.5, 1.0))
    (found,) = standing(flat(models=(config,)))
    assert found.mesh[:, 6:9].mean(axis=0) == pytest.approx((0.0, 0.5, 1.0), abs=0.01)


def test_faces_of_a_model_look_outwards(models: Path) -> None:
    for file in ("arrow.gltf", "arrow.obj", "arrow.stl"):
        mesh = model(models / file).mesh
        outwards = mesh[:, :3] - mesh[:, :3].mean(axis=0)
        assert (outwards * mesh[:, 3:6]).sum(axis=1).min() > 0.0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("nowhere.glb", None, "No such file"),
        ("house.dae", b"<COLLADA/>", "is no model: the formats are .glb"),
        ("broken.gltf", b"{", "can't be read"),
        ("text.glb", b"hello", "can't be read"),
        ("empty.obj", b"# nothing\n", "can't be read|has no triangles"),
        ("line.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n", "can't be read|has no triangles"),
        ("cut.stl", stl()[:150], "can't be read"),
        ("millimetres.stl", None, "m large"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_file_that_is_no_model_is_refused_in_a_sentence(
    tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    if name == "millimetres.stl":
        faces = b"".join(struct.pack("<12fH", 0, 0, 0, *(1000.0 * ARROW[side]).ravel(), 0) for side in SIDES)
        content = bytes(80) + struct.pack("<I", len(SIDES)) + faces
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=words) as caught:
        model(tmp_path / name)
    assert str(caught.value).startswith("models in simulator.toml: ")
    assert name in str(caught.value)


def test_a_model_of_too_many_triangles_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "fine.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * 20_001)
    with pytest.raises(ConfigError, match=r"has 20,001 triangles, and 20,000 are the most"):
        model(file)
