"""Where the team goes next: the planner fed with what the agent knows, and people's requests."""

from dataclasses import replace

from explore_slam.agent.agent import Agent
from explore_slam.data import VehicleState, VehicleStatus
from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    Planner,
    PlanningMode,
    PlanningResult,
    VehicleSnapshot,
)


class TeamPlanner:
    """Plans for the agent's vehicles; explores unless paused or called home."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._planner = Planner(agent.config.exploration)
        self._searched = False
        self.mode = PlanningMode.EXPLORE
        self.result = PlanningResult(ExplorationStatus.STARTED, 'nothing searched yet')

    def configure(self, config: ExplorationConfig) -> None:
        """Go on with other settings; targets and black list start anew."""
        if config != self._planner.config:
            self._planner = Planner(config)

    def pause(self, paused: bool) -> None:
        """Let the vehicles stand, or explore again."""
        self.mode = PlanningMode.PAUSED if paused else PlanningMode.EXPLORE

    def return_home(self) -> None:
        """Send every vehicle to where it started."""
        self.mode = PlanningMode.RETURN_HOME

    def reset(self) -> None:
        """Forget targets, black list and mode."""
        self._planner = Planner(self._agent.config.exploration)
        self._searched = False
        self.mode = PlanningMode.EXPLORE
        for track in self._agent.tracks.values():
            track.plan = None

    def report_follower(self, vehicle: str, text: str, now: float) -> None:
        """Take what a path follower says ('driving', 'blocked: why', ...)."""
        track = self._agent.tracks[vehicle]
        newly = text.startswith('blocked') and not track.follower.startswith('blocked')
        if newly and track.plan is not None:
            self._planner.report_blocked(vehicle, track.plan.goal, now)
        track.follower = text

    def plan(self, now: float) -> PlanningResult:
        """Search frontiers, choose targets, make paths; the agent's tracks carry the plans."""
        vehicles = {status.vehicle: self._snapshot(status) for status in self._agent.statuses()}
        result = self._planner.plan(self._agent.grid, now, vehicles, self.mode)
        if not result.searched and not self._searched and self.mode is not PlanningMode.PAUSED:
            result = replace(result, status=ExplorationStatus.STARTED)  # no map yet: no pause
        self._searched |= result.searched
        for name, track in self._agent.tracks.items():
            track.plan = result.plans.get(name)
            track.state = self._state(name, result)
        self.result = result
        return result

    def _snapshot(self, status: VehicleStatus) -> VehicleSnapshot:
        active = status.state not in (VehicleState.SILENT, VehicleState.LOST)
        home = self._agent.start_poses[status.vehicle]
        return VehicleSnapshot(self._agent.map_pose(status.vehicle), active, home)

    def _state(self, vehicle: str, result: PlanningResult) -> VehicleState:
        if self._agent.tracks[vehicle].follower.startswith('blocked'):
            return VehicleState.BLOCKED
        if vehicle in result.plans:
            returning = result.status is ExplorationStatus.RETURNING
            return VehicleState.RETURNING if returning else VehicleState.DRIVING
        return {
            ExplorationStatus.COMPLETE: VehicleState.DONE,
            ExplorationStatus.RETURNED: VehicleState.HOME,
        }.get(result.status, VehicleState.WAITING)
