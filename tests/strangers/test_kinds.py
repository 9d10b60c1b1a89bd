"""Every kind of defect that files of strangers have shown, and the tests that keep it mended; a table for readers.

The kinds are those of an attack on an early version: 63 raw exceptions, 20 bombs of memory, 3 hangs, and three ways to
write, take or run what is not the program's own.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.blender_home import ROOT

STRANGERS, FOLDERS, RESULT = "strangers/", "results/test_foreign_folders.py", "results/test_folder.py"
CAPTURES, FILES, JOBS = (f"{STRANGERS}test_{name}.py" for name in ("captures", "files", "jobs"))
ATTACKS, CURRENT, COMPILED = (
    f"{STRANGERS}test_attacks.py",
    "headless/test_foreign_current_folder.py",
    "base/test_compiled.py",
)
KINDS: dict[str, list[tuple[str, str]]] = {
    "reading a result moves files into a folder that is a link": [
        (FOLDERS, "test_reading_a_result_changes_nothing_anywhere"),
        (FOLDERS, "test_saving_over_a_result_stays_in_its_folder"),
        (FOLDERS, "test_only_files_of_a_result_are_taken_into_it"),
        (ATTACKS, "test_a_folder_that_is_exchanged_for_a_link_between_check_and_use_loses_nothing_outside"),
    ],
    "reading a result takes the files of a folder that it links to": [
        (FOLDERS, "test_reading_a_result_changes_nothing_anywhere"),
        (ATTACKS, "test_reading_moves_nothing_through_links_of_any_kind"),
    ],
    "code of the current folder runs": [
        (CURRENT, "test_making_and_testing_an_environment_imports_nothing_from_the_current_folder"),
        (CURRENT, "test_blender_loads_no_library_of_the_current_folder"),
        (CURRENT, "test_ffmpeg_is_never_that_of_the_current_folder"),
        (COMPILED, "test_a_configuration_in_the_current_folder_is_not_read"),
        (ATTACKS, "test_no_command_runs_code_of_the_current_folder"),
        (ATTACKS, "test_a_blend_runs_no_code_whatever_the_preferences_say"),
    ],
    "what is written or deleted goes through a link or a second name": [
        (FOLDERS, "test_checkpoints_that_are_a_link_are_left_alone"),
        (FOLDERS, "test_clearing_checkpoints_takes_its_own_files_alone"),
        (FOLDERS, "test_a_solve_refuses_a_linked_folder_before_it_begins"),
        (ATTACKS, "test_a_log_is_a_new_file"),
        (ATTACKS, "test_a_lock_that_is_another_file_too_is_not_emptied"),
    ],
    "a number of frames without end": [
        (JOBS, "test_a_length_has_an_end"),
        (JOBS, "test_a_film_looks_at_the_frames_that_are_there"),
        (JOBS, "test_a_summary_looks_at_the_frames_that_are_there"),
    ],
    "a job that fails ends the others": [
        (JOBS, "test_jobs_that_cannot_run_are_told_before_any_runs"),
        (JOBS, "test_a_job_whose_traceback_has_no_place_does_not_end_the_batch"),
    ],
    "large parts behind the small one of an EXR": [
        (CAPTURES, "test_parts_of_an_exr_behind_the_picture_are_not_decoded"),
        (CAPTURES, "test_sizes_of_all_parts_count"),
    ],
    "light shares that are a bomb": [(JOBS, "test_light_shares_are_looked_at_before_they_are_decoded")],
    "light shares of several sizes": [(JOBS, "test_light_shares_of_two_sizes_are_refused")],
    "pipes, devices and files without end": [
        (FILES, "test_a_pipe_a_device_and_a_folder_are_no_files"),
        (FILES, "test_a_file_that_is_too_large_is_not_read"),
        (JOBS, "test_a_result_with_a_pipe_in_it_does_not_block"),
    ],
    "a damaged archive of a cache or a checkpoint": [
        (FILES, "test_a_damaged_cache_file_is_made_again"),
        (FILES, "test_an_archive_that_decompresses_without_end_is_not_read"),
    ],
    "integers of any length": [
        (CAPTURES, "test_integers_of_any_length_are_no_numbers"),
        (FILES, "test_what_is_no_finite_number_is_none"),
        (JOBS, "test_a_relighting_job_of_values_that_cannot_be_is_refused"),
        (JOBS, "test_a_result_of_values_that_cannot_be_is_refused"),
    ],
    "an .npy that is none": [
        (FILES, "test_an_npy_that_is_none_is_named"),
        (FILES, "test_an_archive_renamed_to_npy_is_named"),
    ],
    "a PNG without pixels": [(CAPTURES, "test_a_png_without_pixels_is_named")],
    "a capture that reaches above its folder": [
        (CAPTURES, "test_a_model_given_by_its_folder_does_not_reach_further_up")
    ],
    "a panorama that is no picture": [("blender/test_lights.py", "test_a_panorama_that_is_no_image_is_named")],
    "an error of several lines": [
        (FILES, "test_messages_are_one_line_whatever_they_quote"),
        (CAPTURES, "test_names_out_of_files_stay_on_one_line"),
        (CAPTURES, "test_what_libraries_log_of_a_damaged_file_is_not_printed"),
        (JOBS, "test_the_command_says_one_line_and_exits_3"),
        (ATTACKS, "test_what_an_importer_of_blender_prints_is_not_the_error"),
    ],
    "a long field of a table": [(CAPTURES, "test_tables_of_exposures_that_are_none_are_named")],
    "names that are no file": [(CAPTURES, "test_a_name_that_is_no_photo_is_one_line")],
    "the home folder of nobody": [
        (JOBS, "test_a_relighting_job_of_values_that_cannot_be_is_refused"),
        (JOBS, "test_an_object_of_values_that_cannot_be_is_refused"),
    ],
    "options beyond what Blender takes": [
        (JOBS, "test_options_beyond_what_blender_takes_are_usage_errors"),
        (JOBS, "test_twice_the_largest_seed_fits_into_blender"),
    ],
    "cameras and meshes far away": [(CAPTURES, "test_cameras_and_meshes_far_away_are_refused")],
    "values of jobs that overflow": [(JOBS, "test_a_relighting_job_of_values_that_cannot_be_is_refused")],
    "the header of a PLY": [
        (CAPTURES, "test_a_ply_that_names_a_texture_is_read_in_silence"),
        (CAPTURES, "test_a_ply_with_a_count_that_is_none_is_refused"),
    ],
    "names of photos that break what they are written into": [
        (JOBS, "test_a_result_of_values_that_cannot_be_is_refused"),
    ],
    "nesting without end": [
        (FILES, "test_json_of_any_depth_and_integers_of_any_length_are_refused_or_read"),
        (JOBS, "test_what_is_no_job_file_is_named"),
        (ATTACKS, "test_a_job_file_that_is_a_bomb_is_refused_at_once"),
    ],
    "a GLB that announces or repeats more than it has": [
        (CAPTURES, "test_a_glb_of_zeros_that_are_not_in_it_is_refused"),
        (CAPTURES, "test_a_glb_that_repeats_its_mesh_is_refused"),
    ],
    "a response that decompresses": [
        (JOBS, "test_a_response_is_not_decompressed_by_its_name"),
        (JOBS, "test_a_response_file_is_read_before_anything_is_traced"),
    ],
    "a path on a server": [(CAPTURES, "test_a_path_out_of_the_capture_is_refused_before_the_disk_is_asked")],
    "reading while another process saves": [
        (RESULT, "test_a_result_is_read_whole_while_another_process_replaces_it"),
        (RESULT, "test_a_save_killed_while_it_moves_files_is_read_as_the_new_result_and_completed_by_the_next"),
    ],
    "damaged compiled code, or a full disk": [
        (COMPILED, "test_a_damaged_file_of_compiled_code_is_made_again"),
        (COMPILED, "test_a_full_disk_costs_time_alone"),
        (COMPILED, "test_compiled_code_is_not_read_from_a_folder_that_others_write"),
    ],
    "what a killed process leaves": [
        (FILES, "test_what_a_killed_write_left_goes_and_nothing_else"),
        (JOBS, "test_a_solve_removes_what_killed_ones_left"),
    ],
}
"""Tests by the kind of defect; paths are relative to the folder of the tests."""


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_tests(kind: str) -> None:
    for file, name in KINDS[kind]:
        tree = ast.parse((ROOT / "tests" / Path(file)).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, f"{file}::{name}"
