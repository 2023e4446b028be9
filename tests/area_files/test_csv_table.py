"""Tables of corners: what is read, and the sentences for what is not."""

from pathlib import Path
from typing import Any

import pytest

from tests.area_files.samples import FIELD, degrees, near, read, sentence


def table(heading: str, corners: Any, separator: str = ",") -> str:
    return "\n".join([heading, *(separator.join(map(str, corner)) for corner in corners)]) + "\n"


LAT_LON, EAST_NORTH = degrees(FIELD), [corner[::-1] for corner in FIELD]


@pytest.mark.parametrize(
    "text",
    [
        table("latitude,longitude", LAT_LON),
        table("lon,lat", [corner[::-1] for corner in LAT_LON]),
        table("x,y", [corner[::-1] for corner in LAT_LON]),
        table("Latitude (deg);Longitude (deg)", LAT_LON, ";"),
        table("lat;lon", LAT_LON, ";").replace(".", ","),
        table("lat\tlon", LAT_LON, "\t"),
        table("lat lon", LAT_LON, "  "),
        table("name,latitude,longitude,altitude", [("corner 1", *corner, 488) for corner in LAT_LON]),
        table('"name","lat","lng"', [('"field, north"', *corner) for corner in LAT_LON]),
        table("\ufeffnorth,east", FIELD),
        "sep=;\r\n" + table("Latitude;Longitude", LAT_LON, ";").replace(".", ","),
        '\ufeff"sep=,"\n' + table("lat,lon", LAT_LON),
        "sep=\t\n" + table("lat\tlon", LAT_LON, "\t"),
        "sep=|\n" + table("lat|lon", LAT_LON, "|"),
        table("east,north", EAST_NORTH),
        table("east_m; north_m", EAST_NORTH, "; "),
        "\r\n".join(["north,east", *(f"{north},{east}" for north, east in FIELD), ",", ""]),
    ],
)
def test_the_headings_of_a_table_are_obeyed(tmp_path: Path, text: str) -> None:
    area = read(tmp_path, "area.csv", text)
    assert near(area.polygon_ned_m, FIELD)


@pytest.mark.parametrize("separator", [",", ", ", ";", " ", "   ", "\t"])
def test_a_table_without_headings_is_north_and_east_in_metres_from_its_first_line_on(
    tmp_path: Path, separator: str
) -> None:
    text = "\n".join(separator.join(map(str, corner)) for corner in FIELD)
    assert near(read(tmp_path, "area.csv", text, metres=True).polygon_ned_m, FIELD)
    refused = sentence(tmp_path, "area.csv", text)
    assert refused.startswith('line 1: "0.0') and "has no headings" in refused and "add --metres" in refused


def test_a_table_has_an_empty_line_before_each_hole(tmp_path: Path) -> None:
    area = read(tmp_path, "area.csv", "\nnorth,east\n0,0\n9,0\n9,9\n\n1,1\n1.5,1\n1.5,1.2\n\n\n3,3\n4,3\n4,4\n\n")
    assert near(area.polygon_ned_m, ((0, 0), (9, 0), (9, 9)))
    assert area.holes_ned_m == (((1, 1), (1.5, 1), (1.5, 1.2)), ((3, 3), (4, 3), (4, 4)))


@pytest.mark.parametrize(
    ("text", "metres", "why"),
    [
        ("0,0\n1,zero\n", True, 'line 2: "1,zero" is not 2 columns with numbers for north and east'),
        ("0,0\n1\n", True, 'line 2: "1" is not 2 columns'),
        ("0,0,488\n", True, 'line 1: "0,0,488" is not 2 columns'),
        ("0,0\n0,1\n1_0,1\n", True, 'line 3: "1_0,1" is not 2 columns'),
        ("0,0\n0,nan\n", True, 'line 2: "0,nan" is not 2 columns'),
        ("47,39 8,54\n", True, "line 1:"),
        ("a,b\n0,0\n", True, 'line 1: "a,b" is neither two numbers nor a line of headings: write "latitude,longitude"'),
        ("northing,easting\n5249465,465765\n", False, 'line 1: "northing,easting" is neither'),
        (
            "lat,lon\n47,8\nlat,lon\n",
            False,
            'line 3: "lat,lon" is not 2 columns with numbers for latitude and longitude',
        ),
        ("lat,lon\n47,8,488\n", False, 'line 2: "47,8,488" is not 2 columns'),
        ("lat,latitude,lon\n1,1,1\n", False, "has two columns for latitude"),
        ("lat,lon\n47,8\n", True, 'line 1: "lat,lon" names degrees: leave out --metres'),
        ("x,y\n0,0\n", True, 'line 1: "x,y" doesn\'t say which column is north'),
        ("lat,lon\n", False, "has no corners"),
        ("north,east\n0,0\n4,4\n", False, "the outline has 2 corners, and an area needs three"),
        ("north,east\n0,0\n4,4\n4,0\n\n1,1\n", False, "hole 1, after an empty line, has 1 corner, and an area needs"),
        ("north,east\n0,0\n\n4,4\n4,0\n0,4\n", False, "the outline, up to the empty line, has 1 corner, and an"),
        (b"\xe9,\n", False, "is no text in UTF-8: save it as UTF-8"),
        ('lat,lon\n"47,8\n', False, "line 2:"),
    ],
)
def test_a_line_that_is_not_understood_is_refused_and_named(
    tmp_path: Path, text: str | bytes, metres: bool, why: str
) -> None:
    assert why in sentence(tmp_path, "area.csv", text, metres=metres)
