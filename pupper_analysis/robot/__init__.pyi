from .build import with_efforts as with_efforts
from .stability import Stability as Stability
from .stability import step_stability as step_stability
from .tool import Tool as Tool
from .tool import find_tool as find_tool
from .tool import with_payload as with_payload
