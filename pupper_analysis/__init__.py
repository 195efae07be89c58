"""Checks a legged robot's URDF and MJCF against each other, and predicts how it stands.

    import pupper_analysis as pa

    robot = pa.load_variant("long-leg")
    stand = pa.solve_stand(robot)
    torques = pa.gravity_compensation(pa.Configuration(robot, stand.qpos)).joint_torques
    report = pa.verify_stand(robot, stand)

Everything public speaks MuJoCo's qpos and qvel, with the joints in actuator order; see
``pupper_analysis.convention``. Names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pupper_analysis.analysis import Analysis, analyze_variant
    from pupper_analysis.audit import Audit, audit_model
    from pupper_analysis.band import SettledBand, settled_band
    from pupper_analysis.best import BestStance, Objective, best_stance
    from pupper_analysis.comparison import Comparison, compare_models
    from pupper_analysis.configuration import Configuration
    from pupper_analysis.crosscheck import CrossCheck, cross_check
    from pupper_analysis.description import write_variant
    from pupper_analysis.dynamics import InverseDynamics, inverse_dynamics
    from pupper_analysis.envelope import (
        Interval,
        PoseEnvelope,
        pose_envelope,
        reachable_heights,
    )
    from pupper_analysis.errors import (
        ConfigurationError,
        Infeasibility,
        ModelError,
        NoEquilibriumError,
        NoStiffnessError,
        NotSettlingError,
        OutputError,
        PupperAnalysisError,
        StanceUnreachableError,
        StaticsInfeasibleError,
        UnknownNameError,
        VariantError,
    )
    from pupper_analysis.explain import Tolerances
    from pupper_analysis.fastest import Binding, FastestPath, Limit, fastest_path
    from pupper_analysis.loaded import with_payload
    from pupper_analysis.path import StancePath, stance_path
    from pupper_analysis.payload import PayloadLimit, payload_limit
    from pupper_analysis.payload_servos import Command
    from pupper_analysis.payload_simulation import PayloadTrial, payload_trial
    from pupper_analysis.push import PushRecovery, push_recovery
    from pupper_analysis.results import to_json
    from pupper_analysis.robot import Robot, load_robot, load_variant
    from pupper_analysis.settle import SettledPose, least_kp, settled_pose
    from pupper_analysis.simulation import (
        GainSweep,
        StandVerification,
        sweep_gains,
        verify_stand,
    )
    from pupper_analysis.sink import sunk_stand
    from pupper_analysis.stand import Stand, solve_stand, stand_statics
    from pupper_analysis.statics import GravityCompensation, LoadSharing, gravity_compensation
    from pupper_analysis.task import Ground, StandTask
    from pupper_analysis.tracking import PathTracking, track_path
    from pupper_analysis.variants import VARIANTS, VariantSpec

__version__ = "0.1.0"

_HOME = {
    "Analysis": "analysis",
    "analyze_variant": "analysis",
    "Audit": "audit",
    "audit_model": "audit",
    "BestStance": "best",
    "Objective": "best",
    "best_stance": "best",
    "Comparison": "comparison",
    "Interval": "envelope",
    "PoseEnvelope": "envelope",
    "pose_envelope": "envelope",
    "reachable_heights": "envelope",
    "InverseDynamics": "dynamics",
    "inverse_dynamics": "dynamics",
    "Binding": "fastest",
    "FastestPath": "fastest",
    "Limit": "fastest",
    "fastest_path": "fastest",
    "StancePath": "path",
    "stance_path": "path",
    "PathTracking": "tracking",
    "track_path": "tracking",
    "PayloadLimit": "payload",
    "payload_limit": "payload",
    "Command": "payload_servos",
    "PayloadTrial": "payload_simulation",
    "payload_trial": "payload_simulation",
    "with_payload": "loaded",
    "NoEquilibriumError": "errors",
    "NoStiffnessError": "errors",
    "NotSettlingError": "errors",
    "PushRecovery": "push",
    "push_recovery": "push",
    "SettledBand": "band",
    "settled_band": "band",
    "SettledPose": "settle",
    "least_kp": "settle",
    "settled_pose": "settle",
    "stand_statics": "stand",
    "sunk_stand": "sink",
    "compare_models": "comparison",
    "Tolerances": "explain",
    "OutputError": "errors",
    "Configuration": "configuration",
    "CrossCheck": "crosscheck",
    "cross_check": "crosscheck",
    "write_variant": "description",
    "ConfigurationError": "errors",
    "Infeasibility": "errors",
    "ModelError": "errors",
    "PupperAnalysisError": "errors",
    "StanceUnreachableError": "errors",
    "StaticsInfeasibleError": "errors",
    "UnknownNameError": "errors",
    "VariantError": "errors",
    "to_json": "results",
    "Robot": "robot",
    "load_robot": "robot",
    "load_variant": "robot",
    "GainSweep": "simulation",
    "StandVerification": "simulation",
    "sweep_gains": "simulation",
    "verify_stand": "simulation",
    "Stand": "stand",
    "Ground": "task",
    "StandTask": "task",
    "solve_stand": "stand",
    "GravityCompensation": "statics",
    "LoadSharing": "statics",
    "gravity_compensation": "statics",
    "VARIANTS": "variants",
    "VariantSpec": "variants",
}

__all__ = [
    "VARIANTS",
    "Analysis",
    "Audit",
    "BestStance",
    "Binding",
    "Command",
    "Comparison",
    "Configuration",
    "ConfigurationError",
    "CrossCheck",
    "FastestPath",
    "GainSweep",
    "GravityCompensation",
    "Ground",
    "Infeasibility",
    "Interval",
    "InverseDynamics",
    "Limit",
    "LoadSharing",
    "ModelError",
    "NoEquilibriumError",
    "NoStiffnessError",
    "NotSettlingError",
    "Objective",
    "OutputError",
    "PathTracking",
    "PayloadLimit",
    "PayloadTrial",
    "PoseEnvelope",
    "PupperAnalysisError",
    "PushRecovery",
    "Robot",
    "SettledBand",
    "SettledPose",
    "StancePath",
    "StanceUnreachableError",
    "Stand",
    "StandTask",
    "StandVerification",
    "StaticsInfeasibleError",
    "Tolerances",
    "UnknownNameError",
    "VariantError",
    "VariantSpec",
    "analyze_variant",
    "audit_model",
    "best_stance",
    "compare_models",
    "cross_check",
    "fastest_path",
    "gravity_compensation",
    "inverse_dynamics",
    "least_kp",
    "load_robot",
    "load_variant",
    "payload_limit",
    "payload_trial",
    "pose_envelope",
    "push_recovery",
    "reachable_heights",
    "settled_band",
    "settled_pose",
    "solve_stand",
    "stance_path",
    "stand_statics",
    "sunk_stand",
    "sweep_gains",
    "to_json",
    "track_path",
    "verify_stand",
    "with_payload",
    "write_variant",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
