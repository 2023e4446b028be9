"""Areas from files: GeoJSON, CSV, KML and KMZ, QGroundControl plans, and shapefiles.

```python
from jezero import Vehicle
from jezero.area_files import read_area

with Vehicle.connect("uav1") as uav:
    area = read_area("field.kml", uav.odometry().origin_deg)
    goal = uav.area_coverage(
        area.polygon_ned_m, -5.0, holes_ned_m=area.holes_ned_m, origin_deg=area.origin_deg, overlap=0.7
    )
    goal.result()
```
"""

from jezero.area_files.area import Area, place
from jezero.area_files.polygon import AreaFileError, FilePolygon
from jezero.area_files.reader import read_area, read_polygon, read_polygons

__all__ = ["Area", "AreaFileError", "FilePolygon", "place", "read_area", "read_polygon", "read_polygons"]
