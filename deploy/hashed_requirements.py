"""`python -m jezero.deploy.hashed_requirements < report.json`: pip's report of an installation, as a file of hashes.

With `pip install --require-hashes` the image then gets the very files that pip chose when the report was made, or
fails: from whichever host they come, nobody can have exchanged one.
"""

import json
import sys
from collections.abc import Mapping
from typing import Any


def requirements(report: Mapping[str, Any]) -> str:
    """The requirements, one a line with the hash of its file, in the order of their names.

    Packages of a folder, such as this project itself, are left out: they have no file.

    Args:
        report: what `pip install --dry-run --ignore-installed --report FILE` writes, as pip's page "Installation
            Report" describes it.

    Raises:
        ValueError: a package comes from elsewhere, such as a repository, and has no hash.
    """
    lines = []
    for package in report["install"]:
        name, version = package["metadata"]["name"], package["metadata"]["version"]
        origin = package["download_info"]
        if "dir_info" in origin:
            continue
        sha256 = origin.get("archive_info", {}).get("hashes", {}).get("sha256")
        if sha256 is None:
            raise ValueError(f"{name} {version} has no sha256 in the report: install it from an index")
        lines.append(f"{name.lower()}=={version} --hash=sha256:{sha256}")
    return "".join(f"{line}\n" for line in sorted(lines))


if __name__ == "__main__":
    sys.stdout.write(requirements(json.load(sys.stdin)))
