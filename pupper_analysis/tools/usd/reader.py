"""What `models.readers` asks of a format."""

from pupper_analysis.tools.usd.as_files import read_usd_as_mjcf as read_as_mjcf
from pupper_analysis.tools.usd.as_files import read_usd_as_urdf as read_as_urdf
from pupper_analysis.tools.usd.file import read_usd as read_file
from pupper_analysis.tools.usd.model import read_usd_model as read_model
from pupper_analysis.tools.usd.rules import CHECKS

__all__ = ["CHECKS", "read_as_mjcf", "read_as_urdf", "read_file", "read_model"]
