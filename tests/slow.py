"""The tests that `make test` leaves out: they take seconds of processor time, and others prove most of what they do.

An entry is a file, a test of it, or a test with the beginning of its parameters. `make test-rest` runs them.
"""

SLOW = (
    # C that is compiled for other machines, with other compilers, or with a flaw.
    "test_arm_boards.py",
    "test_arm_build.py",
    "test_arm_can.py",
    "test_arm_drivers.py",
    "test_arm_motors.py",
    "test_arm_real_time.py",
    "test_catalogue.py::test_an_unsafe_firmware_is_caught",
    "test_fmi3_calls.py::test_a_life_passes_the_sanitizers",
    "test_fmu_build.py",
    "test_fmu_check.py::test_a_fault_is_found_by_its_part_and_is_of_its_kind",
    "test_fmu_check.py::test_a_part_of_many_short_calls_is_no_hang",
    "test_fmu_check.py::test_a_check_that_is_ended_leaves_no_child_and_no_files",
    "test_fmu_check.py::test_a_description_that_does_not_fit_the_library_is_found",
    "test_fmu_check.py::test_what_is_not_claimed_is_not_tested",
    "test_fmu_platforms.py",
    "test_foreign_fmu.py::test_the_shim_passes_the_sanitizers_over_a_foreign_fmu",
    "test_fuzz.py",
    "test_identify.py",
    "test_install.py",
    "test_mujoco_fmu.py",
    "test_reset_cause.py",
    "test_mutants.py::test_every_mutant_of_the_c_sources_compiles",
    # Emulators, browsers, other kernels.
    "test_qemu.py",
    "test_socketcan_inside.py",
    "test_targets.py",
    "test_telemetry_live.py::test_a_browser_is_served_on_the_loopback_interface_until_interrupted",
    "test_telemetry_screenshot.py",
    # Sessions of processes that are ended, killed or stopped.
    "test_campaign.py",
    "test_catalogue.py::test_a_pair_in_torque_mode_and_a_run_in_real_time_are_judged_too",
    "test_catalogue.py::test_a_run_that_hangs_is_ended_and_one_that_crashes_is_told",
    "test_comparison.py::test_a_law_that_refuses_fails_or_kills_its_process_is_a_row_with_its_reason",
    "test_comparison.py::test_ctrl_c_ends_the_runs_and_says_so",
    "test_ctl.py::test_another_program_at_the_port_of_a_service_is_recognised",
    "test_ctl.py::test_on_a_terminal_the_status_is_watched_until_ctrl_c",
    "test_foreign_plant_runs.py::test_a_foreign_fmu_takes_down_the_run_in_order",
    "test_foreign_plant_runs.py::test_an_fmu_that_cannot_be_opened_ends_with_exit_code_3",
    "test_foreign_plant_runs.py::test_in_two_processes_both_end_with_exit_code_3",
    "test_foreign_plant_runs.py::test_what_a_chatty_fmu_prints_is_recorded_in_part_and_disturbs_nothing",
    "test_foreign_plant_runs.py::test_odometry_of_a_robot_in_another_process_begins_there_too",
    "test_foreign_plant_runs.py::test_ctrl_c_stops_the_robot_while_its_plant_goes_on",
    "test_pytest_plugin_install.py",
    "test_rearm_processes.py",
    "test_service_live.py::test_an_api_process_that_is_killed_or_hangs_is_restarted_with_its_port_and_token",
    "test_tick_watch.py",
    "test_trace.py::test_a_trace_of_a_run_that_was_killed_is_readable_up_to_the_cut",
    "test_trace.py::test_a_device_traces_its_own_end",
    "test_verify.py::test_a_verification_that_was_killed_goes_on",
    # Many runs, or long ones.
    "test_verify.py::test_a_file_of_tests_notices_a_mutant_also_in_the_process_of_a_robot",
    "test_comparison.py::test_the_command_gives_and_writes_the_figures_of_the_runs_the_same_every_time",
    "test_fmu_calls.py::test_two_thousand_instances_leave_nothing_behind",
    "test_law_code.py::test_a_pair_review_says_that_the_laws_file_changed",
    "test_makers_runs.py::test_the_papers_circle_is_tracked_through_each",
    "test_reproduction.py::test_the_json_keeps_its_form",
    "test_reproduction.py::test_the_pictures_open",
    "test_reproduction.py::test_nothing_is_commanded_until_the_host_comes",
    "test_reproduction.py::test_the_main_runs_are_recorded",
    "test_reproduction.py::test_what_is_printed_has_every_verdict",
    "test_reproduction.py::test_the_page_has_the_figures_of_a_run",
    "test_reproduction.py::test_results_are_written_between_the_marks",
    "test_review.py::test_a_recording_with_a_damaged_index_is_read_without_it",
    "test_three_plants.py::test_a_controller_within_the_grip_tracks_the_circle_on_each_plant",
    "test_two_processes.py::test_an_abandoned_lockstep_robot_is_put_back_to_its_start",
    # What `make test` proves in a cheaper way too: over other links, in this process, or for the shipped parts.
    "test_batch_engine.py::test_a_job_beyond_a_limit_is_lost_with_its_process_and_the_next_is_done",
    "test_can_errors.py::test_a_handshake_in_vain_says_what_the_bus_tells",
    "test_can_errors.py::test_an_interface_without_can_fd_is_refused",
    "test_catalogue.py::test_a_wrong_outcome_is_a_row_of_the_table_and_its_recording_is_kept",
    "test_cli.py::test_fmu_commands",
    "test_cli.py::test_the_same_run_in_two_processes_gives_equal_figures_and_bytes",
    "test_foreign_plant_runs.py::test_the_example_of_the_page_runs_as_written",
    "test_fused_runs.py::test_another_process_says_where_the_robot_is",
    "test_guardian.py::test_one_that_hangs_is_replaced_whether_it_watches_or_is_asked_to",
    "test_guardian.py::test_one_that_starts_slowly_is_not_taken_for_one_that_hangs",
    "test_guardian.py::test_a_pause_of_the_host_is_not_taken_for_one_of_the_guardians",
    "test_pytest_plugin_fixtures.py",
    "test_pytest_plugin_scenarios.py",
    "test_remote_plant.py",
    "test_review_pages.py",
    "test_serial_ports.py::test_a_handshake_over_noise_says_that_the_baud_rate_is_wrong",
    "test_serial_ports.py::test_a_handshake_in_silence_names_the_link",
    "test_serial_ports.py::test_nobody_waits_for_a_serial_server_that_does_not_answer",
    "test_telemetry_recording.py::test_the_recorder_finishes_the_file_of_a_run_that_was_killed",
    "test_telemetry_recording.py::test_a_recorder_that_is_killed_is_restarted_and_nothing_is_lost",
    "test_unicorn.py",
)


def is_slow(file: str, name: str) -> bool:
    """Tell whether a test is in the list, by the name of its file and its own with its parameters."""
    function = name.partition("[")[0]
    return any(entry in (file, f"{file}::{function}") for entry in SLOW) or any(
        "[" in entry and f"{file}::{name}".startswith(entry) for entry in SLOW
    )
