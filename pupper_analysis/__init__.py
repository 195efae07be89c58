"""Checks a legged robot's URDF and MJCF against each other, and predicts how it stands.

    import pupper_analysis as pa

    robot = pa.load_variant("long-leg")
    stand = pa.solve_stand(robot)
    torques = pa.gravity_compensation(pa.Configuration(robot, stand.qpos)).joint_torques
    report = pa.verify_stand(robot, stand)

Everything public speaks MuJoCo's qpos and qvel, with the joints in actuator order; see
``pupper_analysis.robot.coordinates``. Names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pupper_analysis.drivers import import_mujoco

if TYPE_CHECKING:
    from pupper_analysis.analysis.robot import Analysis, analyze_variant
    from pupper_analysis.checks.audit import Audit, audit_model
    from pupper_analysis.checks.compare import Comparison, compare_models
    from pupper_analysis.checks.engines import CrossCheck, cross_check
    from pupper_analysis.checks.versions.compare import ModelDiff, diff_models
    from pupper_analysis.convert.conversion import Conversion
    from pupper_analysis.convert.model import convert_model
    from pupper_analysis.errors import (
        ConfigurationError,
        Infeasibility,
        MissingPackageError,
        ModelError,
        NoEquilibriumError,
        NoStiffnessError,
        NotSettlingError,
        NotStandingError,
        OutputError,
        PupperAnalysisError,
        StanceUnreachableError,
        StaticsInfeasibleError,
        StudyError,
        UnknownNameError,
        VariantError,
    )
    from pupper_analysis.guard.check import RepositoryCheck, check_repository
    from pupper_analysis.matching.tolerances import Tolerances
    from pupper_analysis.prepare.load import load_robot
    from pupper_analysis.pupper.load import load_variant
    from pupper_analysis.pupper.studies import Study
    from pupper_analysis.pupper.variant_files import write_variant
    from pupper_analysis.pupper.variants import VARIANTS, VariantSpec
    from pupper_analysis.report.html.write import write_report
    from pupper_analysis.results import to_json
    from pupper_analysis.robot.configuration import Configuration
    from pupper_analysis.robot.ground import Ground
    from pupper_analysis.robot.payload import with_payload
    from pupper_analysis.robot.robot import Robot
    from pupper_analysis.robot.stability import Stability, step_stability
    from pupper_analysis.simulation.gain_sweep import GainSweep, sweep_gains
    from pupper_analysis.simulation.payload import (
        Buckling,
        PayloadTrial,
        payload_buckling,
        payload_trial,
    )
    from pupper_analysis.simulation.push import PushRecovery, push_recovery
    from pupper_analysis.simulation.push_trial import PushTrial, push_trial
    from pupper_analysis.simulation.stability import stand_stability
    from pupper_analysis.simulation.tracking import PathTracking, track_path
    from pupper_analysis.simulation.verify import StandVerification, verify_stand
    from pupper_analysis.stance.optimize.best import BestStance, best_stance
    from pupper_analysis.stance.optimize.search import Objective
    from pupper_analysis.stance.path.fastest import FastestPath, fastest_path
    from pupper_analysis.stance.path.leg_time import Binding
    from pupper_analysis.stance.path.path_limits import Limit
    from pupper_analysis.stance.path.stance_path import StancePath, stance_path
    from pupper_analysis.stance.payload.limit import PayloadLimit, payload_limit
    from pupper_analysis.stance.payload.servo_limit import Command
    from pupper_analysis.stance.sag.band import SteadyStateBand, steady_state_band
    from pupper_analysis.stance.sag.steady_state import SteadyState, minimum_stiffness, steady_state
    from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
    from pupper_analysis.stance.stands import solve_stands
    from pupper_analysis.stance.sunk import held_stand, sunk_stand
    from pupper_analysis.stance.task import StandTask
    from pupper_analysis.stance.workspace import (
        BaseWorkspace,
        Interval,
        base_workspace,
        reachable_heights,
    )
    from pupper_analysis.statics.equilibrium import (
        ForceDistribution,
        GravityCompensation,
        gravity_compensation,
    )
    from pupper_analysis.statics.inverse_dynamics import InverseDynamics, inverse_dynamics
    from pupper_analysis.statics.states import GravityCompensations, gravity_compensations
    from pupper_analysis.study.outcome import StudyOutcome, study_outcome
    from pupper_analysis.study.pareto import pareto_front
    from pupper_analysis.study.randomisation import write_randomisation
    from pupper_analysis.study.sensitivity import linear_shares, sobol_indices
    from pupper_analysis.study.table import read_study
    from pupper_analysis.study.tolerance import (
        certainty,
        tightest_tolerance,
    )
    from pupper_analysis.study.variables import linspace, log_uniform, normal, uniform, values
    from pupper_analysis.sync.models import Sync, sync_models

__version__ = "0.2.0"

import_mujoco()

_HOME = {
    "Analysis": "analysis.robot",
    "analyze_variant": "analysis.robot",
    "Audit": "checks.audit",
    "audit_model": "checks.audit",
    "BestStance": "stance.optimize.best",
    "Objective": "stance.optimize.search",
    "best_stance": "stance.optimize.best",
    "Comparison": "checks.compare",
    "Conversion": "convert.conversion",
    "convert_model": "convert.model",
    "Interval": "stance.workspace",
    "BaseWorkspace": "stance.workspace",
    "base_workspace": "stance.workspace",
    "reachable_heights": "stance.workspace",
    "InverseDynamics": "statics.inverse_dynamics",
    "inverse_dynamics": "statics.inverse_dynamics",
    "Binding": "stance.path.leg_time",
    "FastestPath": "stance.path.fastest",
    "Limit": "stance.path.path_limits",
    "fastest_path": "stance.path.fastest",
    "StancePath": "stance.path.stance_path",
    "stance_path": "stance.path.stance_path",
    "PathTracking": "simulation.tracking",
    "track_path": "simulation.tracking",
    "PayloadLimit": "stance.payload.limit",
    "payload_limit": "stance.payload.limit",
    "Command": "stance.payload.servo_limit",
    "Stability": "robot.stability",
    "step_stability": "robot.stability",
    "stand_stability": "simulation.stability",
    "Buckling": "simulation.payload",
    "PayloadTrial": "simulation.payload",
    "payload_buckling": "simulation.payload",
    "payload_trial": "simulation.payload",
    "with_payload": "robot.payload",
    "NoEquilibriumError": "errors",
    "NoStiffnessError": "errors",
    "NotSettlingError": "errors",
    "NotStandingError": "errors",
    "PushRecovery": "simulation.push",
    "push_recovery": "simulation.push",
    "PushTrial": "simulation.push_trial",
    "push_trial": "simulation.push_trial",
    "SteadyStateBand": "stance.sag.band",
    "steady_state_band": "stance.sag.band",
    "SteadyState": "stance.sag.steady_state",
    "minimum_stiffness": "stance.sag.steady_state",
    "steady_state": "stance.sag.steady_state",
    "stand_statics": "stance.stand",
    "held_stand": "stance.sunk",
    "sunk_stand": "stance.sunk",
    "compare_models": "checks.compare",
    "Tolerances": "matching.tolerances",
    "ModelDiff": "checks.versions.compare",
    "diff_models": "checks.versions.compare",
    "OutputError": "errors",
    "Configuration": "robot.configuration",
    "CrossCheck": "checks.engines",
    "cross_check": "checks.engines",
    "write_report": "report.html.write",
    "write_variant": "pupper.variant_files",
    "ConfigurationError": "errors",
    "Infeasibility": "errors",
    "MissingPackageError": "errors",
    "ModelError": "errors",
    "PupperAnalysisError": "errors",
    "StanceUnreachableError": "errors",
    "StaticsInfeasibleError": "errors",
    "UnknownNameError": "errors",
    "VariantError": "errors",
    "to_json": "results",
    "Robot": "robot.robot",
    "load_robot": "prepare.load",
    "load_variant": "pupper.load",
    "GainSweep": "simulation.gain_sweep",
    "StandVerification": "simulation.verify",
    "sweep_gains": "simulation.gain_sweep",
    "verify_stand": "simulation.verify",
    "Stand": "stance.judge",
    "Ground": "robot.ground",
    "StandTask": "stance.task",
    "solve_stand": "stance.stand",
    "solve_stands": "stance.stands",
    "GravityCompensation": "statics.equilibrium",
    "ForceDistribution": "statics.equilibrium",
    "gravity_compensation": "statics.equilibrium",
    "RepositoryCheck": "guard.check",
    "check_repository": "guard.check",
    "GravityCompensations": "statics.states",
    "gravity_compensations": "statics.states",
    "Study": "pupper.studies",
    "StudyError": "errors",
    "StudyOutcome": "study.outcome",
    "study_outcome": "study.outcome",
    "read_study": "study.table",
    "pareto_front": "study.pareto",
    "sobol_indices": "study.sensitivity",
    "linear_shares": "study.sensitivity",
    "certainty": "study.tolerance",
    "tightest_tolerance": "study.tolerance",
    "write_randomisation": "study.randomisation",
    "linspace": "study.variables",
    "log_uniform": "study.variables",
    "normal": "study.variables",
    "uniform": "study.variables",
    "values": "study.variables",
    "Sync": "sync.models",
    "sync_models": "sync.models",
    "VARIANTS": "pupper.variants",
    "VariantSpec": "pupper.variants",
}

__all__ = [
    "VARIANTS",
    "Analysis",
    "Audit",
    "BaseWorkspace",
    "BestStance",
    "Binding",
    "Buckling",
    "Command",
    "Comparison",
    "Configuration",
    "ConfigurationError",
    "Conversion",
    "CrossCheck",
    "FastestPath",
    "ForceDistribution",
    "GainSweep",
    "GravityCompensation",
    "GravityCompensations",
    "Ground",
    "Infeasibility",
    "Interval",
    "InverseDynamics",
    "Limit",
    "MissingPackageError",
    "ModelDiff",
    "ModelError",
    "NoEquilibriumError",
    "NoStiffnessError",
    "NotSettlingError",
    "NotStandingError",
    "Objective",
    "OutputError",
    "PathTracking",
    "PayloadLimit",
    "PayloadTrial",
    "PupperAnalysisError",
    "PushRecovery",
    "PushTrial",
    "RepositoryCheck",
    "Robot",
    "Stability",
    "StancePath",
    "StanceUnreachableError",
    "Stand",
    "StandTask",
    "StandVerification",
    "StaticsInfeasibleError",
    "SteadyState",
    "SteadyStateBand",
    "Study",
    "StudyError",
    "StudyOutcome",
    "Sync",
    "Tolerances",
    "UnknownNameError",
    "VariantError",
    "VariantSpec",
    "analyze_variant",
    "audit_model",
    "base_workspace",
    "best_stance",
    "certainty",
    "check_repository",
    "compare_models",
    "convert_model",
    "cross_check",
    "diff_models",
    "fastest_path",
    "gravity_compensation",
    "gravity_compensations",
    "held_stand",
    "inverse_dynamics",
    "linear_shares",
    "linspace",
    "load_robot",
    "load_variant",
    "log_uniform",
    "minimum_stiffness",
    "normal",
    "pareto_front",
    "payload_buckling",
    "payload_limit",
    "payload_trial",
    "push_recovery",
    "push_trial",
    "reachable_heights",
    "read_study",
    "sobol_indices",
    "solve_stand",
    "solve_stands",
    "stance_path",
    "stand_stability",
    "stand_statics",
    "steady_state",
    "steady_state_band",
    "step_stability",
    "study_outcome",
    "sunk_stand",
    "sweep_gains",
    "sync_models",
    "tightest_tolerance",
    "to_json",
    "track_path",
    "uniform",
    "values",
    "verify_stand",
    "with_payload",
    "write_randomisation",
    "write_report",
    "write_variant",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    return found  # and is asked for no more


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
