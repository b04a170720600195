"""The table of faults: cause, expected outcome, event or counter, and tests that prove it."""

from __future__ import annotations

from faults.fault import Fault
from faults.strangers_table import STRANGERS

STREAM, DISK, FLIPPED, BOMBS = (
    "faults/test_stream_faults.py::", "faults/test_full_disk.py::", "faults/test_flipped_bytes.py::",
    "faults/test_bombs.py::",
)  # fmt: skip
RECORD, DECODER = "host/verbs/test_verb_record.py::", "host/ingest/node/test_decoder.py::"
PORTS, RECOVER, WRITER = (
    "host/ingest/link/test_ports.py::", "host/log/test_recover.py::",
    "host/log/test_log_writer.py::",
)  # fmt: skip
KILL, JUMPS, UNIT = (
    "faults/test_kill.py::", "host/ingest/live/test_host_clock.py::", "host/verbs/test_verb_service.py::",
)  # fmt: skip
BULKHEADS, UNREAD, REPORTS, NMEA = (
    "host/ingest/live/test_bulkheads.py::", "host/ingest/live/test_timeout_stream.py::",
    "host/ingest/node/test_node_session.py::", "host/ingest/gnss/test_nmea.py::",
)  # fmt: skip
WEEKS, SERIES, SEALED = (
    "host/ingest/live/test_loop.py::", "host/log/test_log_series.py::", "host/ingest/link/test_sealed.py::",
)  # fmt: skip
LOCALIZER = "host/ingest/live/test_localizer.py::"
GUESSES, CONNECTIONS = "host/web/test_guess_limiter.py::", "host/web/test_bounded_connections.py::"

FLOODS, LINKS, SENDERS = (
    "faults/test_floods_udp.py::", "host/ingest/link/test_link.py::", "host/ingest/node/test_senders.py::",
)  # fmt: skip

RECORDING = (
    Fault(
        "unplugged at every byte of a frame", "that frame is lost, the rest comes",
        "frames cut; gap: link down",
        (STREAM + "test_a_disconnection_at_any_byte_of_a_frame_loses_that_frame_with_its_cause",
         RECORD + "test_ten_disconnections_damage_and_a_reset_lose_no_frame_and_every_gap_has_a_cause"),
    ),
    Fault(
        "EIO, ENODEV while reading", "the link is down, then looked for", "disconnected",
        (STREAM + "test_a_port_that_fails_or_is_ready_without_data_is_down_with_a_reason",
         STREAM + "test_a_disconnected_device_ends_the_link"),
    ),
    Fault(
        "ready to read, but no data", "the link is down", "disconnected: read by somebody else",
        (STREAM + "test_a_port_that_fails_or_is_ready_without_data_is_down_with_a_reason",),
    ),
    Fault(
        "two readers of a port", "the second is refused", "busy",
        (STREAM + "test_a_second_hubodo_reader_of_a_port_is_refused", RECORD + "test_a_busy_port_is_refused"),
    ),
    Fault(
        "wrong baud rate", "told with both rates; silence is not taken for it", "foreign, silent",
        (STREAM + "test_silence_after_frames_is_not_foreign_data_but_another_baud_rate_is",
         PORTS + "test_bytes_at_another_baud_rate_are_counted_and_both_rates_of_a_node_are_named"),
    ),
    Fault(
        "a port that babbles at 3 MB/s", "memory and log bounded, other links whole", "bytes not logged",
        (STREAM + "test_a_port_with_random_data_at_3_mb_per_s_loses_no_sample_of_the_others",),
    ),
    Fault(
        "the node crashes into its prompt", "told what to do", "foreign: MicroPython prompt",
        (STREAM + "test_a_node_that_crashes_into_its_prompt_is_reported_although_it_is_silent",),
    ),
    Fault(
        "the node is reset within a frame", "that frame is lost, the new start begins at 0", "damage, reset",
        (STREAM + "test_a_node_that_is_reset_within_a_frame_loses_that_frame_only",
         DECODER + "test_a_restart_whose_hello_was_lost_is_suspected_and_settled_by_the_next_hello"),
    ),
    Fault(
        "two nodes with one id on two ports", "both recorded, the second renamed", "notice",
        (RECORD + "test_two_nodes_with_one_name_are_both_recorded",),
    ),
    Fault(
        "two nodes with one id on one line", "kept raw, not mixed", "conflict; frames unread",
        (STREAM + "test_two_nodes_with_one_id_on_one_line_are_reported_and_not_mixed",
         STREAM + "test_a_board_that_was_exchanged_while_unplugged_is_no_conflict"),
    ),
    Fault(
        "numbers and microseconds turn over", "nothing is lost", "no gap",
        (STREAM + "test_a_wrap_of_numbers_or_microseconds_is_no_loss",
         DECODER + "test_lost_samples_are_counted_exactly_across_wraps_of_both_counters"),
    ),
    Fault(
        "the node's clock goes backwards", "its samples wait for a Hello", "no gap, no reset",
        (STREAM + "test_with_a_node_clock_stepped_back_samples_wait_for_hello_without_loss",),
    ),
    Fault(
        "a node of an older protocol", "refused by name, raw frames kept", "mismatch; frames unread",
        (RECORD + "test_a_node_with_another_protocol_is_refused_by_name_and_its_raw_frames_stored",
         RECORD + "test_a_node_with_another_protocol_does_not_end_the_recording_of_a_valid_one"),
    ),
    Fault(
        "the port is back under another name", "found by its serial number", "connected at ...",
        (PORTS + "test_a_device_is_found_under_another_name_by_its_serial_number",),
    ),
    Fault(
        "killed at any moment", "all until a second before is recovered",
        "recover: messages kept, bytes lost",
        (KILL + "test_after_sigkill_all_data_up_to_one_second_before_is_recovered",
         KILL + "test_a_kill_during_rotation_loses_half_a_second_and_earlier_logs_are_complete",
         RECORD + "test_after_a_kill_all_but_the_last_second_is_recovered",
         RECOVER + "test_from_a_log_cut_at_any_byte_every_complete_chunk_is_recovered_and_nothing_else"),
    ),
    Fault(
        "disk full at any stage of a verb", "code 1, nothing half, what was there stays", "the file's name",
        (DISK + "test_a_disk_that_fills_at_any_stage_leaves_no_incomplete_file",
         DISK + "test_a_full_file_system_is_one_line_and_leaves_no_file",
         DISK + "test_a_calibration_that_cannot_be_written_stays_as_it_was"),
    ),
    Fault(
        "disk full while recording", "what did not fit is lost; room begins another log",
        "NOT RECORDING; /healthz 503",
        (WRITER + "test_a_full_disk_loses_only_pending_messages_and_leaves_a_valid_log",
         SERIES + "test_a_full_disk_pauses_the_log_and_free_space_starts_another"),
    ),
    Fault(
        "the log is deleted or replaced while recording", "noticed within a second, another begun, code 1",
        "event; messages lost",
        (SERIES + "test_a_deleted_or_renamed_log_is_detected_within_a_second_and_recording_continues",
         WEEKS + "test_a_log_deleted_while_recording_is_reported_everywhere_and_the_run_fails"),
    ),
    Fault(
        "the log is emptied or written to by another program",
        "noticed within a second, another begun, code 1",
        "event; messages lost",
        (SERIES + "test_a_log_truncated_by_another_program_is_detected_within_a_second_and_the_next_starts",
         SERIES + "test_a_log_deleted_or_changed_just_before_its_end_is_counted_as_well",
         WEEKS + "test_a_log_emptied_while_recording_is_reported_everywhere_and_the_run_fails"),
    ),
    Fault(
        "a clock that is behind, and a disk budget", "the oldest logs by number are removed", "names of logs",
        (SERIES + "test_with_a_clock_that_is_behind_the_oldest_logs_are_still_deleted_first",
         SERIES + "test_recorders_with_other_names_in_one_folder_have_separate_numbers",
         SERIES + "test_numbers_continue_in_a_folder_with_other_files"),
    ),
    Fault(
        "the wall clock is set while recording", "the log goes on without a step",
        "event: clock, with the size",
        (JUMPS + "test_a_wall_clock_that_is_set_is_an_event_with_its_size_and_moves_no_sample",
         JUMPS + "test_a_process_interrupted_between_two_readings_reports_no_step"),
    ),
    Fault(
        "a clock that nobody has set", "recorded and marked; the service waits for no network",
        "event: clock; metadata; info",
        (JUMPS + "test_a_log_with_an_unset_clock_is_marked_and_info_reports_it",
         JUMPS + "test_the_state_of_a_clock_follows_from_its_time_and_timesyncd",
         UNIT + "test_the_unit_wants_a_synchronised_clock_but_does_not_wait_for_the_network"),
    ),
    Fault(
        "the computer stands still, or its clock jumps", "what was lost is counted, nothing else",
        "one event: clock; gap: the computer stood still",
        (JUMPS + "test_a_computer_that_stood_still_for_ten_minutes_is_one_event_and_no_lost_sample",
         JUMPS + "test_samples_sent_during_a_standstill_of_the_computer_are_counted",
         JUMPS + "test_no_jump_of_the_hosts_clock_adds_or_hides_a_lost_sample",
         PORTS + "test_a_frame_cut_by_a_suspension_is_not_foreign_data"),
    ),
    Fault(
        "the terminal is closed", "the log is whole, code 0; ignored under nohup", "exit code",
        (WEEKS + "test_a_closed_terminal_ends_the_recording_with_a_complete_log_and_exit_code_0",
         WEEKS + "test_under_nohup_a_closed_terminal_does_not_end_the_recording"),
    ),
    Fault(
        "nodes of different firmware", "recorded, and said at once", "warning",
        (RECORD + "test_nodes_that_run_different_firmware_are_named_while_recording_and_in_the_log",),
    ),
    Fault(
        "the folder of the log is removed", "the log pauses, the odometry goes on",
        "NOT RECORDING; /healthz 503",
        (WEEKS + "test_a_removed_folder_pauses_the_log_but_not_the_odometry_and_health_reports_it",),
    ),
    Fault(
        "logs are cut by time and size", "every message once, as in a single log", "one head each",
        (SERIES + "test_logs_rotated_by_time_hold_every_message_once_in_order_and_each_has_the_metadata",
         WEEKS + "test_rotated_logs_hold_the_samples_of_a_single_log"),
    ),
    Fault(
        "the power is cut", "at most five seconds are lost", "recover: bytes lost",
        (SERIES + "test_a_power_cut_loses_at_most_five_seconds",),
    ),
    Fault(
        "datagrams forged, changed, sent again", "refused", "event: refused, by cause",
        (SEALED + "test_a_datagram_with_a_changed_bit_is_refused",
         SEALED + "test_datagrams_of_an_earlier_session_are_refused",
         SEALED + "test_senders_without_a_key_are_refused_with_the_cause"),
    ),
    Fault(
        "a folder that may only be read", "code 1, nothing left", "the file's name",
        (DISK + "test_a_read_only_folder_is_named_in_one_line",),
    ),
    Fault(
        "the folder of a result is removed", "code 1 or 2, nothing left", "the file's name",
        (DISK + "test_a_folder_removed_before_the_result_is_written",),
    ),
    Fault(
        "a byte of a log turned over", "noticed, whichever it is; a damaged attachment is not used",
        "info: damaged places",
        (FLIPPED + "test_each_changed_byte_is_detected",
         FLIPPED + "test_a_changed_radius_and_a_changed_zero_of_time_are_reported_by_the_verbs"),
    ),
    Fault(
        "a small file that claims to be huge", "not believed, memory bounded", "warning, or refused",
        (BOMBS + "test_a_log_of_some_kilobytes_does_not_allocate_gigabytes",
         BOMBS + "test_the_size_in_a_truncated_chunk_is_checked_too",
         BOMBS + "test_an_array_that_claims_more_than_its_file_holds_is_refused"),
    ),
    Fault(
        "a wild time stamp", "refused where a grid would be laid up to it", "the pause and its ends",
        (BOMBS + "test_a_wild_time_stamp_creates_no_grid_of_gigabytes",
         BOMBS + "test_no_verb_creates_a_grid_up_to_a_wild_time_stamp"),
    ),
    Fault(
        "memory that is not there", "code 1", "one line",
        (BOMBS + "test_a_failed_allocation_is_an_error_of_one_line",),
    ),
    Fault(
        "idle or slow connections to the page or the metrics", "shed; a visitor is answered", "nothing",
        (CONNECTIONS + "test_of_three_hundred_idle_connections_most_are_closed_and_a_visitor_is_served",
         CONNECTIONS + "test_requests_sent_byte_by_byte_do_not_block_a_visitor",
         CONNECTIONS + "test_connections_waiting_in_the_tls_handshake_are_closed_too",
         CONNECTIONS + "test_without_a_free_descriptor_a_pending_connection_is_closed"),
    ),
    Fault(
        "60 visitors guess the token", "at most 90 guesses/s for an address; its owner waits 0.75 s",
        "status 429 beyond 64 at once",
        (GUESSES + "test_the_guesses_of_an_address_are_limited_whatever_its_number_of_connections",
         GUESSES + "test_beside_sixty_guessing_connections_of_one_address_its_owner_waits_one_hold_at_most",
         GUESSES + "test_an_owner_at_another_address_is_never_refused"),
    ),
    Fault(
        "a part of the recorder raises at every call", "that part alone is lost, 16 kinds of part",
        "event: fault, with the bytes; metrics",
        (BULKHEADS + "test_a_part_that_raises_at_every_call_loses_no_sample_of_the_others",
         BULKHEADS + "test_a_foxglove_server_that_raises_or_hangs_loses_no_sample",
         BULKHEADS + "test_the_bytes_that_a_node_failed_on_are_in_the_event_and_its_frames_are_in_the_log"),
    ),
    Fault(
        "a part of the recorder hangs at every call", "interrupted, tried again after a pause",
        "event: fault, no return within 2 s",
        (BULKHEADS + "test_a_part_that_hangs_at_every_call_loses_no_sample_of_the_others",
         BULKHEADS + "test_a_suspended_part_is_tried_again_after_pauses_that_double_up_to_a_minute"),
    ),
    Fault(
        "the graph of the map fails or stalls", "another one in the same map frame", "event: fault of map",
        (LOCALIZER + "test_a_graph_that_fails_is_reported_and_replaced_by_one_in_the_same_map_frame",
         BULKHEADS + "test_a_stalled_output_thread_is_replaced_and_its_late_return_ignored"),
    ),
    Fault(
        "the log can no longer be written", "the recording ends, what there is stays", "code 1",
        (BULKHEADS + "test_a_log_that_cannot_be_written_ends_the_recording_and_stays_readable",),
    ),
    Fault(
        "nobody reads standard error or output", "lines are dropped, SIGTERM is obeyed", "code 0",
        (UNREAD + "test_a_hanging_reader_blocks_neither_the_log_nor_the_exit",
         UNREAD + "test_a_line_that_was_cut_off_is_completed_before_the_next"),
    ),
    Fault(
        "the reader of standard error is gone", "the recording goes on", "event: fault of terminal",
        (UNREAD + "test_a_closed_reader_does_not_end_the_recording",),
    ),
    Fault(
        "started with closed standard streams", "no log gets their descriptors", "code 0",
        (UNREAD + "test_the_log_does_not_use_descriptors_of_closed_standard_streams",),
    ),
    Fault(
        "reports without samples, microseconds that turn over", "stamped when received", "no fault",
        (REPORTS + "test_a_battery_report_without_samples_has_the_time_of_reception",
         REPORTS + "test_a_wrap_of_the_microseconds_gives_no_negative_time"),
    ),
    Fault(
        "NMEA with nan, inf, 1e200 and a valid checksum", "the sentence is left out",
        "sentences not understood",
        (NMEA + "test_sentences_with_hostile_fields_and_valid_checksums_are_counted_and_nothing_is_raised",
         NMEA + "test_sigmas_of_zero_are_treated_as_unknown"),
    ),
    Fault(
        "300 nodes without keys on a UDP port", "64 recorded, known ones lose nothing", "event: refused",
        (FLOODS + "test_three_hundred_nodes_lose_no_sample_of_the_four_known_ones",
         SENDERS + "test_of_298_nodes_on_a_udp_port_64_are_recorded_and_the_others_reported",
         SENDERS + "test_a_line_has_64_nodes_at_most_too",
         SENDERS + "test_there_is_always_a_free_name"),
    ),
    Fault(
        "12,000 addresses on a UDP port", "memory bounded, known nodes lose nothing",
        "hubodo_senders_evicted_total",
        (FLOODS + "test_thousands_of_addresses_lose_no_sample_of_four_nodes_and_need_little_memory",
         SENDERS + "test_twelve_thousand_addresses_use_no_memory_and_lose_nothing_of_the_known_node",
         SENDERS + "test_a_sender_without_hello_queues_a_bounded_number_of_frames"),
    ),
    Fault(
        "300 handshakes a second, forged or sent again", "nothing stored, a node that restarts gets in",
        "event: refused, by cause",
        (FLOODS + "test_forged_and_replayed_handshakes_keep_no_node_out_and_lose_no_sample",
         SEALED + "test_thousands_of_forged_or_replayed_handshakes_store_nothing_and_keep_no_node_out",
         SEALED + "test_the_earlier_session_is_valid_until_the_node_uses_the_next"),
    ),
    Fault(
        "a node with the older handshake", "refused by name", "event: refused, flash it again",
        (SEALED + "test_a_node_with_the_first_handshake_is_refused_with_a_remedy",),
    ),
    Fault(
        "a bridge that accepts and closes", "tried every 8 s in the end", "disconnected, with a count",
        (LINKS + "test_a_bridge_that_accepts_and_closes_is_tried_less_and_less_often",
         LINKS + "test_pauses_double_to_eight_seconds_and_a_valid_frame_resets_them",
         LINKS + "test_connections_without_a_frame_are_few_events_and_a_frame_makes_the_next_loss_one"),
    ),
    Fault(
        "a driver raises what no driver should", "that attempt ends, the link is tried again",
        "disconnected; hubodo_link_faults_total",
        (LINKS + "test_an_unexpected_exception_ends_that_attempt_and_the_link_is_retried",
         LINKS + "test_a_driver_that_raises_is_counted_in_the_log_and_the_node_beside_it_loses_nothing",
         LINKS + "test_a_list_of_ports_that_cannot_be_read_is_a_reason_not_an_end"),
    ),
    Fault(
        "a driver hangs in any call", "no other link waits for it", "the link's own silence",
        (LINKS + "test_a_hanging_transport_blocks_neither_sending_nor_closing_nor_other_links",),
    ),
    Fault(
        "descriptors beyond 1,023", "ports are read whatever their number", "nothing",
        ("host/ingest/test_readiness.py::test_a_descriptor_beyond_those_of_select_is_waited_for",),
    ),
    Fault(
        "the wall clock is set", "the status is as old as time has passed", "/healthz 200",
        ("host/web/test_web_live.py::"
         "test_the_age_of_a_snapshot_does_not_depend_on_the_wall_clock",),
    ),
    Fault(
        "a line that says ever other serials", "one conflict, bounded memory", "conflict; frames unread",
        (STREAM + "test_a_line_with_many_serial_numbers_is_one_conflict_with_bounded_memory",),
    ),
    Fault(
        "SIGTERM while nothing is sent", "obeyed", "code 0",
        ("host/ingest/live/test_computer.py::"
         "test_a_signal_whose_handler_outlasts_the_wait_does_not_make_it_endless",),
    ),
)  # fmt: skip

FAULTS = (*RECORDING, *STRANGERS)
