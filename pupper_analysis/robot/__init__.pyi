from .payload import with_payload as with_payload
from .stability import Stability as Stability
from .stability import step_stability as step_stability
