"""`metadata.yaml` of a rosbag2 directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibration_core.errors import RecordingError
from calibration_core.files.yaml_file import YamlFile, read_yaml

METADATA = "metadata.yaml"
SECTION = "rosbag2_bagfile_information"
MAX_BYTES = 1 << 20


def metadata_file(file: Path) -> YamlFile:
    """Read the metadata of a bag; `information` takes it apart.

    Raises:
        RecordingError: It cannot be read, or is no plain YAML.
    """
    return read_yaml(file, MAX_BYTES, "file of metadata (YAML)", RecordingError)


def information(content: YamlFile) -> dict[str, Any]:
    """Return what rosbag2 writes about a bag.

    Raises:
        RecordingError: It is no metadata of rosbag2.
    """
    section = content.data.get(SECTION) if isinstance(content.data, dict) else None
    if not isinstance(section, dict):
        raise RecordingError(content.path, SECTION, "nothing", "metadata as rosbag2 writes it")
    return section


def read_metadata(file: Path) -> dict[str, Any]:
    """Read and take apart in one step."""
    return information(metadata_file(file))
