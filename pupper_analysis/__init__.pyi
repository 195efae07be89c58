from . import (
    analysis as analysis,
)
from . import (
    checks as checks,
)
from . import (
    convert as convert,
)
from . import (
    errors as errors,
)
from . import (
    guard as guard,
)
from . import (
    identification as identification,
)
from . import (
    matching as matching,
)
from . import (
    posture as posture,
)
from . import (
    pupper as pupper,
)
from . import (
    report as report,
)
from . import (
    results as results,
)
from . import (
    robot as robot,
)
from . import (
    simulation as simulation,
)
from . import (
    stance as stance,
)
from . import (
    statics as statics,
)
from . import (
    study as study,
)
from . import (
    sync as sync,
)
from .analysis.best import best_stance as best_stance
from .analysis.hold import hold_posture as hold_posture
from .analysis.judge import judge_stand as judge_stand
from .analysis.payload import payload_limit as payload_limit
from .analysis.robot import analyze_variant as analyze_variant
from .checks.audit import audit_model as audit_model
from .checks.compare import compare_models as compare_models
from .checks.engines import cross_check as cross_check
from .checks.versions.compare import diff_models as diff_models
from .convert.load import load_robot as load_robot
from .convert.model import convert_model as convert_model
from .errors import (
    ConfigurationError as ConfigurationError,
)
from .errors import (
    MissingPackageError as MissingPackageError,
)
from .errors import (
    ModelError as ModelError,
)
from .errors import (
    NoEquilibriumError as NoEquilibriumError,
)
from .errors import (
    NoStiffnessError as NoStiffnessError,
)
from .errors import (
    NotSettlingError as NotSettlingError,
)
from .errors import (
    NotStandingError as NotStandingError,
)
from .errors import (
    OutputError as OutputError,
)
from .errors import (
    PupperAnalysisError as PupperAnalysisError,
)
from .errors import (
    StanceUnreachableError as StanceUnreachableError,
)
from .errors import (
    StaticsInfeasibleError as StaticsInfeasibleError,
)
from .errors import (
    StudyError as StudyError,
)
from .errors import (
    UnknownNameError as UnknownNameError,
)
from .errors import (
    VariantError as VariantError,
)
from .identification.fit import fit as fit
from .identification.measurements.log_files import read_log as read_log
from .identification.measurements.stands import read_stands as read_stands
from .pupper.load import load_variant as load_variant
from .pupper.studies import Study as Study
from .pupper.variants import VARIANTS as VARIANTS
from .robot.configuration import Configuration as Configuration
from .robot.ground import Ground as Ground
from .robot.robot import Robot as Robot
from .simulation.push import push_recovery as push_recovery
from .simulation.verify import verify_stand as verify_stand
from .stance.judge import Stand as Stand
from .stance.sag.steady_state import steady_state as steady_state
from .stance.stand import solve_stand as solve_stand
from .stance.stands import solve_stands as solve_stands
from .stance.task import StandTask as StandTask
from .statics.equilibrium import gravity_compensation as gravity_compensation
from .study.table import read_study as read_study
from .sync.models import sync_models as sync_models

__version__: str
