"""Markers of the tests by file or name, for `make check` and `make uncompiled`.

* `ros`: starts ROS nodes or other processes.
* `slow`: takes more than a few seconds of processor time, without ROS.
* `equations`: equations without ROS that are quick without compilation, too.
"""

from collections.abc import Iterator

EQUATIONS = {
    *("test_actuator", "test_car", "test_constraints", "test_gain_table", "test_interpolation"),
    *("test_laguerre", "test_lateral_mpc", "test_metrics", "test_model", "test_pacejka"),
    *("test_path", "test_prediction", "test_preview_model", "test_progress", "test_pure_pursuit"),
    *("test_qp", "test_scenario", "test_types"),
}
"""Files of the equations. ROS nodes and closed loops are left out: they would take minutes."""
MANY_SWEEPS = ("2000", "enough_sweeps")
"""Parts of the names of tests that solve hundreds of problems with thousands of sweeps."""
ROS = {
    *("test_environment", "test_guard_coverage", "test_left_processes", "test_loaded_modules"),
    *(
        "test_compile_all",
        "test_recording",
        "test_report_browser",
        "test_rerun",
        "test_start",
        "test_startup",
        "test_tune",
        "test_watch",
    ),
    "test_a_drive_over_ros_is_identified_and_its_vehicle_file_drives",
    "test_a_process_without_a_home_compiles_into_the_temporary_folder",
    "test_an_installed_copy_of_the_packages_uses_the_code_of_the_source_tree",
    "test_another_process_replays_the_same_bits",
    "test_colcon_builds_every_package_as_ament_python",
    "test_compiled_ticks_agree_with_plain_python",
    "test_processes_on_a_cold_cache_compile_the_same_function_for_different_types",
}
"""Files and tests outside tests/nodes that start nodes or other processes."""
SLOW = {
    *(
        "test_certificate",
        "test_certify",
        "test_claim_by_speed",
        "test_compiled_ticks",
        "test_fitness",
        "test_recover",
        "test_reproduce",
        "test_swarm_of_cars",
    ),
    "test_a_faster_controller_follows_the_path_as_closely",
    "test_charts_of_several_drives_are_exported",
    "test_each_car_of_a_swarm_drives_as_a_car_of_its_own_bit_for_bit",
    "test_every_pair_has_one_cell_and_all_that_repeats_the_run_stands_beside_it",
    "test_further_formats_hold_the_same_numbers",
    "test_path_sent_again_is_followed_like_a_path_sent_once",
    "test_path_sent_at_each_tick_is_followed_like_a_path_sent_once",
    "test_templates_drive_with_the_default_gains",
    "test_paper_s_controller_drives_sc1_as_an_independent_prototype_does",
}
"""Files and tests that compute for more than two seconds, or compile functions of their own."""


def markers_of(file: str, folder: str, name: str) -> Iterator[str]:
    """Return the markers of a test by its file, folder and name."""
    names = {file, name.partition("[")[0]}
    if folder in ("nodes", "workshop") or names & ROS:
        yield "ros"
    elif names & SLOW:
        yield "slow"
    if file in EQUATIONS and not any(part in name for part in MANY_SWEEPS):
        yield "equations"
