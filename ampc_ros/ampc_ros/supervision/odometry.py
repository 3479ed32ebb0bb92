"""Defects of odometry that last: the car can be steered, but a publisher has to be corrected."""

from ampc_msgs_config.parameters import REAR_AXLE, ChassisParameters
from ampc_msgs_config.types import VehicleState
from ampc_ros.supervision.measuring_point import MOST_OMISSION, MeasuringPointEstimate
from ampc_ros.supervision.yaw_rate import MISSING, STUCK, YawRateCheck


class OdometryMonitor:
    """Checks of accepted states over seconds."""

    def __init__(self) -> None:
        """Start without states."""
        self.yaw_rate, self.point = YawRateCheck(), MeasuringPointEstimate()

    def reset(self) -> None:
        """Begin a new history."""
        self.yaw_rate.reset()
        self.point.reset()

    def correct(self, state: VehicleState) -> VehicleState:
        """Add an accepted state; return the state for the controller."""
        corrected = self.yaw_rate.correct(state)
        self.point.observe(corrected)
        return corrected

    def problems(self, chassis: ChassisParameters, base_link_to_cg: float) -> list[str]:
        """Return a sentence for each defect, with what to do about it."""
        sentences = [
            self._yaw_rate(),
            self._lateral_velocity(),
            self._measuring_point(chassis, base_link_to_cg),
        ]
        return [sentence for sentence in sentences if sentence]

    def _yaw_rate(self) -> str:
        check = self.yaw_rate
        if not check.is_replaced:
            return ""
        what = f"twist.twist.angular.z = {check.measured:.3g} rad/s"
        if check.cause == MISSING:
            what += " does not change: the publisher does not set it"
        elif check.cause == STUCK:
            what += " does not change"
        turns = f"the heading turns at {check.expected:.3g} rad/s, which is used instead"
        return f"odom: {check.cause}: {what}; {turns}"

    def _lateral_velocity(self) -> str:
        omitted = self.point.omitted_velocity
        if abs(omitted) <= MOST_OMISSION:
            return ""
        side = "inside" if omitted > 0 else "outside"
        return (
            f"odom: lateral_velocity_missing: twist.twist.linear.y = 0, but the position moves at "
            f"{abs(omitted):.2g} m/s to the {side} of turns: the publisher does not set it"
        )

    def _measuring_point(self, chassis: ChassisParameters, base_link_to_cg: float) -> str:
        point, l_r = self.point.estimate(chassis), chassis.cg_to_rear_axle
        if point is None or not point.contradicts(l_r - base_link_to_cg):
            return ""
        d, most = point.ahead_of_axle, 2 * point.deviation
        wanted = f"{l_r - d:.1f}"
        wanted = "-0.99" if float(wanted) == REAR_AXLE else wanted  # -1 means the rear axle
        return (
            f"odom: measuring_point: in turns the position moves as a point {d:.1f} m "
            f"(+- {most:.1f} m) ahead of the rear axle, but base_link_to_cg = "
            f"{base_link_to_cg:.3g} m means {l_r - base_link_to_cg:.1f} m: "
            f"set base_link_to_cg to {wanted} m "
            f"(0 m: odometry at the centre of gravity, {l_r:.3g} m: at the rear axle)"
        )
