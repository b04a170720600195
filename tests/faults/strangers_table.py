"""Faults caused by foreign files, texts and requests, with the tests that prove the outcome."""

from __future__ import annotations

from faults.fault import Fault

BAGS, MCAP, CSV, NUMBERS = (
    "host/log/test_hostile_bags.py::", "host/log/test_hostile_mcap.py::", "host/log/test_hostile_csv.py::",
    "host/log/test_hostile_numbers.py::",
)  # fmt: skip
SETTINGS, TEXT, PRIVATE, CLAIMS = (
    "host/test_hostile_settings.py::", "host/test_safe_text.py::", "host/test_private_files.py::",
    "host/log/test_input_limits.py::",
)  # fmt: skip
LIBRARY, GUARD, REQUESTS, RESTART = (
    "host/web/test_web_library.py::", "host/web/test_web_guard.py::", "host/web/test_web_fuzz.py::",
    "host/web/test_server_restart.py::",
)  # fmt: skip
EXTRAS, PARTIAL, PROGRAM = (
    "host/test_extras.py::", "host/verbs/test_partial_logs.py::", "host/ingest/live/test_program_log.py::",
)  # fmt: skip

STRANGERS = (
    Fault(
        "NULL, text or numbers where a bag holds bytes", "those rows are left out", "warning, with a count",
        (BAGS + "test_rows_with_values_of_another_type_are_left_out_and_counted",
         BAGS + "test_a_topic_with_an_invalid_name_or_type_is_left_out_with_its_messages",
         BAGS + "test_messages_that_do_not_fit_their_type_are_counted"),
    ),
    Fault(
        "views, triggers, generated columns in a bag", "only stored tables are read, within bounded work",
        "refused, code 2",
        (BAGS + "test_only_stored_tables_are_read",
         BAGS + "test_an_endless_query_of_a_manipulated_file_is_aborted"),
    ),
    Fault(
        "a bag that claims or expands to gigabytes", "refused within --max-memory", "code 2",
        (BAGS + "test_messages_that_claim_more_bytes_than_the_file_has_are_refused",
         BAGS + "test_a_compressed_bag_is_read_and_one_that_expands_beyond_its_size_is_refused",
         BAGS + "test_a_chunk_of_a_ros1_bag_expands_only_up_to_the_limit",
         BAGS + "test_a_record_of_a_ros1_bag_reads_no_more_than_the_file_has"),
    ),
    Fault(
        "a bag that names files outside its folder", "no such file is opened", "refused",
        (BAGS + "test_no_file_outside_the_folder_is_opened",
         BAGS + "test_a_message_definition_in_a_ros1_bag_is_compared_and_never_compiled"),
    ),
    Fault(
        "topics of ours with messages of another type", "no table is made of them", "warning",
        (MCAP + "test_a_hubodo_topic_with_messages_of_another_type_gives_no_table",),
    ),
    Fault(
        "an incomplete schema on export", "that topic is left out of the rosbag2", "named",
        (MCAP + "test_a_topic_with_an_invalid_schema_is_left_out_of_a_rosbag2",),
    ),
    Fault(
        "an MCAP file made to take time or memory", "bounded work and memory", "warning or code 2",
        (MCAP + "test_the_number_of_searches_for_messages_is_bounded",
         MCAP + "test_decoded_messages_stay_within_the_memory_limit",
         MCAP + "test_chunks_that_overlap_in_time_stay_within_the_memory_limit",
         MCAP + "test_damaged_chunks_and_the_bytes_between_them_are_read_once"),
    ),
    Fault(
        "gzip bombs, endless lines, 100,000 columns of CSV", "refused within --max-memory", "code 2, the row",
        (CSV + "test_a_gzipped_file_expands_only_up_to_the_limit_of_its_size",
         CSV + "test_an_endless_line_is_refused_before_it_fills_memory",
         CSV + "test_the_number_of_columns_is_limited_and_a_repeated_one_refused",
         CSV + "test_rows_stay_within_the_memory_limit"),
    ),
    Fault(
        "numbers of 5,000 digits", "refused in one short line", "code 2, row or key",
        (CSV + "test_a_cell_of_thousands_of_digits_is_refused_in_a_short_line",
         SETTINGS + "test_a_hostile_toml_file_is_refused_in_one_short_line"),
    ),
    Fault(
        "pipes and devices in place of files", "refused at once, none is opened", "code 2",
        (CLAIMS + "test_a_fifo_or_device_is_refused_at_once",
         CSV + "test_a_fifo_in_a_folder_is_refused", BAGS + "test_a_fifo_in_a_bag_is_refused",
         NUMBERS + "test_a_pipe_in_place_of_a_file_of_numbers_is_refused",
         SETTINGS + "test_a_pipe_a_device_or_a_folder_is_refused"),
    ),
    Fault(
        "headers of .npy and .npz that claim too much", "compared with the file first", "code 2",
        (NUMBERS + "test_a_numpy_header_is_compared_with_the_file_before_memory_is_allocated",
         NUMBERS + "test_an_archive_that_expands_beyond_the_limit_or_is_ambiguous_is_refused"),
    ),
    Fault(
        "MATLAB and HDF5 bombs, links to other files", "a limited process, links refused", "code 2",
        (NUMBERS + "test_a_matlab_file_is_decoded_within_the_limit",
         NUMBERS + "test_hdf5_with_links_to_other_files_or_false_sizes_is_refused",
         NUMBERS + "test_a_crash_of_a_library_is_an_error_of_one_line"),
    ),
    Fault(
        "settings with nan, 1e300, dates, deep nesting", "refused with the key", "code 2",
        (SETTINGS + "test_each_number_must_be_finite_and_plausible",
         SETTINGS + "test_a_byte_order_mark_is_skipped"),
    ),
    Fault(
        "marks with ESC or half a surrogate pair", "stored and shown escaped", "the escaped text",
        (TEXT + "test_a_mark_is_stored_escaped",
         TEXT + "test_each_verb_survives_a_hostile_mark_and_its_json_is_valid",
         TEXT + "test_printed_texts_contain_no_terminal_control_codes"),
    ),
    Fault(
        "a result that is not a number", "null in JSON", "null",
        (TEXT + "test_json_has_null_for_numbers_that_are_not_finite_and_no_lone_surrogates",
         TEXT + "test_one_function_of_the_package_writes_json",
         PARTIAL + "test_the_error_of_a_stationary_vehicle_has_no_percentage"),
    ),
    Fault(
        "a log with a gyro alone", "reported as far as it goes", "what is missing, by name",
        (PARTIAL + "test_a_report_of_a_gyro_alone_shows_its_noise_and_names_what_is_missing",),
    ),
    Fault(
        "a table of Parquet that is damaged or too large", "refused with its row", "code 2",
        ("host/log/test_parquet_table.py::test_a_faulty_file_is_refused_with_its_row",
         "host/log/test_parquet_table.py::test_a_table_beyond_the_memory_limit_is_not_read"),
    ),
    Fault(
        "an optional package is not installed", "the extra is named", "code 2",
        (EXTRAS + "test_without_extras_a_verb_names_the_missing_extra_and_reports_no_defect",),
    ),
    Fault(
        "links in a shared folder, where a file is written", "none of others is written through", "code 1",
        (PRIVATE + "test_a_link_with_a_guessable_temporary_name_is_not_written_through",
         PRIVATE + "test_a_link_of_another_user_is_refused",
         LIBRARY + "test_results_of_a_job_are_stored_in_pages_and_never_through_a_link",
         LIBRARY + "test_a_link_that_appears_while_a_job_runs_is_not_followed"),
    ),
    Fault(
        "secrets that others can read", "refused alike", "run chmod 600",
        (PRIVATE + "test_token_keys_and_private_key_that_others_can_read_are_refused",),
    ),
    Fault(
        "names of recordings that are not UTF-8", "listed escaped, can be downloaded", "the escaped name",
        (LIBRARY + "test_names_that_are_not_utf8_are_listed_escaped_and_downloaded_by_that_name",),
    ),
    Fault(
        "requests made from chance", "refused, never status 500", "status 4xx",
        (REQUESTS + "test_no_random_request_causes_a_server_error",
         REQUESTS + "test_requests_that_once_caused_a_failure_are_refused"),
    ),
    Fault(
        "a job of the page that does not end", "stopped at its limit, or cancelled", "the job says so",
        (LIBRARY + "test_a_job_is_stopped_at_its_time_limit_and_reports_it",
         LIBRARY + "test_a_cancelled_job_ends_with_its_child_processes"),
    ),
    Fault(
        "a session that is over", "refused on the server, the live feed ends", "status 401",
        (GUARD + "test_a_logout_ends_the_session_on_the_server_and_requires_the_csrf_secret",
         GUARD + "test_a_live_feed_ends_with_its_session"),
    ),
    Fault(
        "the server of page or metrics fails", "started again", "event: fault of page or metrics",
        (RESTART + "test_the_metrics_server_restarts_and_each_error_is_reported_once",
         RESTART + "test_the_page_server_restarts_and_each_error_is_reported_once"),
    ),
    Fault(
        "libraries that warn or raise in threads", "a line each, JSON where asked for", "event: program",
        (PROGRAM + "test_each_message_of_a_library_is_one_line",
         PROGRAM + "test_a_recording_with_the_page_reports_its_end_and_server_errors_in_json"),
    ),
)  # fmt: skip
