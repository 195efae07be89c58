from .posture import Posture as Posture
from .posture import find_posture as find_posture
from .sag import SaggedPosture as SaggedPosture
from .sag import sag_posture as sag_posture
from .tool import Tool as Tool
from .tool import find_tool as find_tool
from .verify import PostureVerification as PostureVerification
from .verify import verify_posture as verify_posture
