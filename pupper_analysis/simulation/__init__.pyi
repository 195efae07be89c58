from .gain_sweep import GainSweep as GainSweep
from .gain_sweep import sweep_gains as sweep_gains
from .payload import (
    Buckling as Buckling,
)
from .payload import (
    PayloadTrial as PayloadTrial,
)
from .payload import (
    payload_buckling as payload_buckling,
)
from .payload import (
    simulate_payload as simulate_payload,
)
from .push import PushRecovery as PushRecovery
from .push_trial import PushTrial as PushTrial
from .push_trial import simulate_push as simulate_push
from .stability import stand_stability as stand_stability
from .tracking import PathTracking as PathTracking
from .tracking import track_path as track_path
from .verify import StandVerification as StandVerification
