from . import present as _present
from . import pupper as pupper
from . import robot as robot
from . import simulation as simulation
from . import stance as stance
from . import statics as statics
from . import tools as _tools
from .base import errors as errors
from .base import results as results
from .base.errors import ConfigurationError as ConfigurationError
from .base.errors import MissingPackageError as MissingPackageError
from .base.errors import ModelError as ModelError
from .base.errors import NoEquilibriumError as NoEquilibriumError
from .base.errors import NoStiffnessError as NoStiffnessError
from .base.errors import NotSettlingError as NotSettlingError
from .base.errors import NotStandingError as NotStandingError
from .base.errors import OutputError as OutputError
from .base.errors import PostureUnreachableError as PostureUnreachableError
from .base.errors import PupperAnalysisError as PupperAnalysisError
from .base.errors import StanceUnreachableError as StanceUnreachableError
from .base.errors import StaticsInfeasibleError as StaticsInfeasibleError
from .base.errors import StudyError as StudyError
from .base.errors import UnknownNameError as UnknownNameError
from .base.errors import VariantError as VariantError
from .prepare.judge import judge_stand as judge_stand
from .pupper.loading import load_robot as load_robot
from .pupper.variant_files import load_variant as load_variant
from .pupper.variants import VARIANTS as VARIANTS
from .robot import matching as matching
from .robot.configuration import Configuration as Configuration
from .robot.ground import Ground as Ground
from .robot.plane import Bar as Bar
from .robot.plane import Contact as Contact
from .robot.plane import Plane as Plane
from .robot.plane import Slope as Slope
from .robot.plane import Weld as Weld
from .robot.robot import Robot as Robot
from .simulation.verify import verify_stand as verify_stand
from .stance.judge import Stand as Stand
from .stance.sag.steady_state import steady_state as steady_state
from .stance.soft_ground import solve_stand_as_simulated as solve_stand_as_simulated
from .stance.stand import solve_stand as solve_stand
from .stance.stand import solve_stands as solve_stands
from .stance.stand import stand_statics as stand_statics
from .stance.task import StandTask as StandTask
from .stance.whole_body import solve_posture as solve_posture
from .statics.equilibrium import gravity_compensation as gravity_compensation
from .tools import check as _check
from .tools import convert as convert
from .tools import fit as _fit
from .tools import hold as _hold
from .tools import study as study
from .tools import sync as sync
from .tools.analyze.analysis import analyze_variant as analyze_variant
from .tools.audit.audit import audit_model as audit_model
from .tools.best.best import best_stance as best_stance
from .tools.convert.model import convert_model as convert_model
from .tools.crosscheck.crosscheck import compare_models as compare_models
from .tools.crosscheck.crosscheck import cross_check as cross_check
from .tools.diff.compare import diff_models as diff_models
from .tools.fit.fit import fit as fit
from .tools.fit.measurements.log import read_log as read_log
from .tools.fit.measurements.stands import read_stands as read_stands
from .tools.hold.hold import hold_posture as hold_posture
from .tools.payload.limit import payload_limit as payload_limit
from .tools.push.recovery import push_recovery as push_recovery
from .tools.study.study import Study as Study
from .tools.study.study import read_study as read_study
from .tools.sync.models import sync_models as sync_models

analysis = _tools
guard = _check
identification = _fit
posture = _hold
report = _present

__version__: str
