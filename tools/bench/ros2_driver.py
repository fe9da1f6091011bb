"""A ROS 2 node that arms the robot, sends cmd_vel at 100 Hz and hears odometry and joint states, until SIGTERM."""

import signal


def main() -> None:
    """Drive in a circle."""
    import rclpy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = rclpy.create_node("driver")
    message, publisher = Twist(), node.create_publisher(Twist, "cmd_vel", 1)
    message.linear.x, message.angular.z = 0.2, 0.4
    node.create_timer(0.01, lambda: publisher.publish(message))
    node.create_subscription(Odometry, "odom", lambda _: None, 10)
    node.create_subscription(JointState, "joint_states", lambda _: None, 10)
    arm = node.create_client(Trigger, "mecanum_hil/arm")
    try:
        while True:
            arm.wait_for_service()
            answer = arm.call_async(Trigger.Request())
            rclpy.spin_until_future_complete(node, answer)
            if answer.result().success:
                break
        rclpy.spin(node)
    except KeyboardInterrupt:
        return


if __name__ == "__main__":
    main()
