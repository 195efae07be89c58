from .build import with_efforts as with_efforts
from .payload import with_payload as with_payload
from .stability import Stability as Stability
from .stability import step_stability as step_stability
from .tool import Tool as Tool
from .tool import find_tool as find_tool
