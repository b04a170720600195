"""Installation of the firmware on boards, and diagnosis of boards and of this computer."""
