"""The tables of a scenario that concern the process in which the controller runs: real time, and the service."""

from pydantic import Field, field_validator

from hil.scenario.fields import Table

PRIORITY = 40
"""Asked for by default. A real-time kernel's threads for interrupts, the serial port's among them, have 50."""


class RealtimeTable(Table):
    """``[realtime]``: what is asked of the operating system in mode realtime; a run says what of it was refused."""

    priority: int = Field(
        default=PRIORITY,
        ge=0,
        le=98,
        description="of SCHED_FIFO, 0 for none; a real-time kernel's interrupt threads have 50",
    )
    cpus: tuple[int, ...] = Field(
        default=(), description="processors to run on; by default the isolated ones, where there are any"
    )
    lock_memory: bool = Field(default=True, description="keep memory from being swapped out")

    @field_validator("cpus")
    @classmethod
    def _numbers(cls, cpus: tuple[int, ...]) -> tuple[int, ...]:
        if min(cpus, default=0) < 0 or len(set(cpus)) != len(cpus):
            raise ValueError("expected the numbers of processors, from 0 and each once")
        return cpus


class ServiceTable(Table):
    """``[service]``: what hil serve lets be asked of the robot; limits are those of twists and of ways to a pose."""

    port: int = Field(default=8770, ge=0, le=65_535, description="of the API on 127.0.0.1; 0 takes a free one")
    twist_timeout_s: float = Field(default=0.2, ge=0.02, le=2, description="silence that ends a drive by twist")
    error_limit_m: float = Field(default=0.5, gt=0, le=100, description="off its path, beyond which the robot is held")
    speed_m_s: float = Field(default=0.5, gt=0, le=20, description="of the robot's centre")
    acceleration_m_s2: float = Field(default=1.0, gt=0, le=50, description="of the robot's centre")
    jerk_m_s3: float = Field(default=5.0, gt=0, le=1000, description="of the robot's centre, on ways to a pose")
    yaw_rate_rad_s: float = Field(default=1.0, gt=0, le=50, description="of the heading")
    yaw_acceleration_rad_s2: float = Field(default=3.0, gt=0, le=500, description="of the heading")
    yaw_jerk_rad_s3: float = Field(default=15.0, gt=0, le=10_000, description="of the heading, on ways to a pose")
