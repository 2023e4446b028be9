"""KML and KMZ files: what is read, and the sentences for what is not."""

import zipfile
from pathlib import Path
from typing import Any

import pytest

from jezero.area_files import AreaFileError, read_area
from tests.area_files.samples import EXAMPLES, FIELD, ORIGIN_DEG, geojson, read, sentence

RING = "<LinearRing><coordinates>{}</coordinates></LinearRing>"
SHAPE = "<Polygon><outerBoundaryIs>{}</outerBoundaryIs></Polygon>"


def coordinates(corners_m: Any) -> str:
    return RING.format(" ".join(f"{longitude},{latitude},0" for longitude, latitude in geojson(corners_m)))


def kml(*placemarks: str) -> str:
    return f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{"".join(placemarks)}</Document></kml>'


def placemark(inside: str, name: str = "") -> str:
    return f"<Folder><Placemark><name>{name}</name>{inside}</Placemark></Folder>"


def test_a_placemark_with_two_polygons_is_two_areas(tmp_path: Path) -> None:
    inside = SHAPE.format(coordinates(FIELD)) + SHAPE.format(coordinates([(100, 0), (100, 9), (110, 9)]))
    text = kml(placemark(f"<MultiGeometry>{inside}</MultiGeometry>", "north"))
    assert "has 2 areas" in sentence(tmp_path, "area.kml", text)
    assert read(tmp_path, "area.kml", text, feature=2).polygon_ned_m[1] == pytest.approx((100, 9), abs=0.001)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("text", "is not KML that can be read"),
        ("<kml>", "is not KML that can be read (no element found"),
        ('<?xml version="1.0" encoding="klingon"?><kml/>', "is not KML that can be read"),
        ("<kml/>", "has no Placemark with a Polygon"),
        (kml(placemark("<LineString/>")), "has no Placemark with a Polygon: it has LineString"),
        (kml("<NetworkLink/>"), "has no Placemark with a Polygon: it has NetworkLink"),
        (kml(placemark("<Polygon/>")), "Placemark 1 has 0 outer boundaries instead of one"),
        (kml(placemark(SHAPE.format(RING.format("8,47 8,48")))), "Placemark 1 has 2 corners, and an area needs three"),
        (kml(placemark(SHAPE.format(RING.format("8, 47")))), 'Placemark 1: "8," is not longitude,latitude'),
        (kml(placemark(SHAPE.format("<LinearRing/>"))), "Placemark 1 has 0 corners"),
    ],
)
def test_what_is_no_kml_area_is_refused_with_its_place(tmp_path: Path, text: str, why: str) -> None:
    assert why in sentence(tmp_path, "area.kml", text)


FIELD_SHAPE = SHAPE.format(coordinates(FIELD))


@pytest.mark.parametrize(
    "text",
    [
        kml("<gx:CascadingStyle kml:id='a'/>", placemark(FIELD_SHAPE)),
        kml(placemark('<gx:altitudeMode x="a:b">clampToGround</gx:altitudeMode>' + FIELD_SHAPE)),
        '<?xml version="1.0"?>\n<!-- a > b -->\n<kml:kml>' + placemark(FIELD_SHAPE) + "</kml:kml>",
        kml(placemark(FIELD_SHAPE)).replace("<kml ", '<!DOCTYPE kml><kml xsi:schemaLocation="a b" '),
        kml("<a xmlns:q='b'><q:c/></a><q:d/>", placemark(FIELD_SHAPE)),
        '<kml xmlns:gx="http://www.google.com/kml/ext/2.2"><gx:Tour/><atom:link/>' + placemark(FIELD_SHAPE) + "</kml>",
    ],
)
def test_prefixes_that_the_file_does_not_declare_are_no_mistake(text: str, tmp_path: Path) -> None:
    assert len(read(tmp_path, "area.kml", text).polygon_ned_m) == 4
    assert len(read(tmp_path, "area.kml", "\ufeff" + text).polygon_ned_m) == 4


@pytest.mark.parametrize("letters", ["a&nbsp;b", "&copy;&uuml;", "&amp;nbsp;", "<![CDATA[a&nbsp;b<br>]]>", "&#160;"])
def test_names_of_letters_of_html_are_read(letters: str, tmp_path: Path) -> None:
    text = kml(f"<description>{letters}</description>", placemark(FIELD_SHAPE, "caf&eacute;"))
    assert read(tmp_path, "area.kml", text, feature="café").name == "café"
    assert "is not KML that can be read" in sentence(tmp_path, "area.kml", kml("&klingon;"))


def test_a_ring_alone_is_an_area_and_the_rings_of_a_polygon_are_none_of_their_own(tmp_path: Path) -> None:
    assert len(read(tmp_path, "area.kml", kml(placemark(coordinates(FIELD)))).polygon_ned_m) == 4
    both = kml(placemark(f"<MultiGeometry>{coordinates(FIELD)}{FIELD_SHAPE}</MultiGeometry>"))
    assert "has 2 areas" in sentence(tmp_path, "area.kml", both)
    assert "Placemark 1 has 0 corners" in sentence(tmp_path, "area.kml", kml(placemark("<LinearRing/>")))


def test_many_comments_without_an_element_are_refused_at_once(tmp_path: Path) -> None:
    assert "is not KML that can be read" in sentence(tmp_path, "area.kml", "<!-- x -->" * 5000)


def test_entities_that_grow_without_bounds_are_refused(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "8,47 "}">' for n in range(12))
    bomb = f"<!DOCTYPE kml [{entities}]>" + kml(placemark(SHAPE.format(RING.format("&e11;"))))
    assert "is not KML that can be read (EntitiesForbidden" in sentence(tmp_path, "area.kml", bomb)
    outside = '<!DOCTYPE kml [<!ENTITY e SYSTEM "file:///etc/passwd">]>' + kml(placemark("&e;"))
    assert "is not KML that can be read (EntitiesForbidden" in sentence(tmp_path, "area.kml", outside)


def test_an_archive_is_read_from_its_main_document_up_to_a_size(tmp_path: Path) -> None:
    text = kml(placemark(SHAPE.format(coordinates(FIELD))))
    with zipfile.ZipFile(tmp_path / "area.kmz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("files/other.kml", "<kml/>")
        archive.writestr("doc.kml", text)
    assert len(read_area(tmp_path / "area.kmz", ORIGIN_DEG).polygon_ned_m) == 4
    with zipfile.ZipFile(tmp_path / "bomb.kmz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", b" " * 60_000_000)
    with pytest.raises(AreaFileError, match="has a document of more than 50 MB"):
        read_area(tmp_path / "bomb.kmz", ORIGIN_DEG)
    with zipfile.ZipFile(tmp_path / "empty.kmz", "w") as archive:
        archive.writestr("readme.txt", "")
    with pytest.raises(AreaFileError, match=r"is an archive without a \.kml file"):
        read_area(tmp_path / "empty.kmz", ORIGIN_DEG)
    assert "is not a KMZ archive that can be read" in sentence(tmp_path, "area.kmz", text)
    packed = (EXAMPLES / "field.kmz").read_bytes()
    assert "is not a KMZ archive that can be read" in sentence(tmp_path, "area.kmz", packed[1:])
