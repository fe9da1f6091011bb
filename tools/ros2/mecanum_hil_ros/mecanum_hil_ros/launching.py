"""What the launch files share: the node, robot_state_publisher with the robot's URDF, and RViz."""

from pathlib import Path
import shlex

from ament_index_python.packages import get_package_prefix
from ament_index_python.packages import get_package_share_directory
from ament_index_python.packages import PackageNotFoundError
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import LogInfo
from launch.actions import OpaqueFunction
from launch.actions import Shutdown
from launch.substitutions import Command
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = 'mecanum_hil_ros'
SHARED = {
    'robot': ('', "the robot's own file, for hil ros2 --robot"),
    'namespace': ('', 'of the node, its topics and services; one for each robot'),
    'params_file': ('', 'parameters of the node; by default those of config/params.yaml'),
}
"""Arguments of both launch files: default and meaning."""

IN_NAMESPACE = [('/tf', 'tf'), ('/tf_static', 'tf_static'), ('/clock', 'clock')]
"""The node publishes these in its namespace; other nodes take them from there."""


def launch_description(arguments, words_of, simulated):
    """
    Return a launch description.

    ``arguments`` are those of the launch file, beside ``SHARED``; ``words_of`` returns the options
    of hil ros2 for their values.
    """
    every = {**arguments, **SHARED}
    declared = [
        DeclareLaunchArgument(name, description=meaning)
        if default is None else
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in every.items()
    ]

    def actions(context):
        values = {name: LaunchConfiguration(name).perform(context) for name in every}
        return _actions(values, words_of(values), simulated)

    return LaunchDescription([*declared, OpaqueFunction(function=actions)])


def _actions(values, words, simulated):
    config = Path(get_package_share_directory(PACKAGE)) / 'config'
    namespace, clock = values['namespace'], {'use_sim_time': simulated}
    robot = [values['config'], *option('--robot', values['robot'])]
    actions = [
        Node(
            package=PACKAGE,
            executable='mecanum_hil',
            name='mecanum_hil',
            namespace=namespace,
            parameters=[values['params_file'] or str(config / 'params.yaml')],
            arguments=[*robot, *words],
            output='screen',
            on_exit=Shutdown(reason='the robot has gone'),
        )
    ]
    if _is_installed('robot_state_publisher'):
        urdf = Command(shlex.join(['hil', 'export', 'urdf', *robot]))
        description = {'robot_description': ParameterValue(urdf, value_type=str)}
        actions.append(
            Node(
                package='robot_state_publisher',
                executable='robot_state_publisher',
                namespace=namespace,
                parameters=[description, clock],
                remappings=IN_NAMESPACE,
                output='screen',
            )
        )
    else:
        actions.append(_missing('robot_state_publisher', 'the links of the robot are not on /tf'))
    if values['rviz'] == 'true':
        if _is_installed('rviz2'):
            actions.append(
                Node(
                    package='rviz2',
                    executable='rviz2',
                    namespace=namespace,
                    arguments=['-d', str(config / 'robot.rviz')],
                    parameters=[clock],
                    remappings=IN_NAMESPACE,
                )
            )
        else:
            actions.append(_missing('rviz2', 'there is no view'))
    return actions


def option(name, value):
    """Return the words of an option, none for an empty value."""
    return [name, value] if value else []


def flag(name, value):
    """Return the word of a flag that a launch argument switches."""
    if value not in ('true', 'false'):
        raise ValueError(f'{name} = {value!r}: expected true or false')
    return [name] if value == 'true' else []


def _is_installed(package):
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def _missing(package, consequence):
    return LogInfo(msg=f'{package} is not installed: {consequence}')
