"""What the pages need to know about the robot to draw it, from `vehicle.toml`."""

from math import radians, tan
from typing import Any

from jezero.frames import q_frd_from_camera
from jezero.services.ground_station.board_picture import board_address
from jezero.vehicle_config import VehicleConfig


def robot_shapes(vehicle: VehicleConfig) -> dict[str, Any]:
    """Sizes of vehicle, camera and platform, in metres, in the axes frd and rover_body."""
    camera, airframe, platform = vehicle.camera, vehicle.airframe, vehicle.platform
    tan_right = tan(0.5 * radians(camera.field_of_view_deg))
    return {
        "stand": airframe.height_stand_m,
        "altimeter": vehicle.height_altimeter_m,
        "rotors": [list(pos_m) for pos_m in airframe.pos_rotors_frd_m],
        "radius": airframe.radius_rotor_m,
        "feet": list(airframe.feet_frd_m),
        "camera": {
            "pos": list(camera.pos_camera_frd_m),
            "q_rest": list(q_frd_from_camera(camera.pitch_rest_rad, camera.roll_offset_rad)),
            "turn": camera.turn_rad,
            "tan_right": tan_right,
            "tan_down": tan_right * camera.height_px / camera.width_px,
        },
        "platform": {
            "side": platform.side_m,
            "height": platform.height_m,
            "picture": board_address(platform),
        },
    }
