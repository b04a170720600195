# Every target does its own set-up; the only thing to bring is Python 3.11 or newer.
PYTHON ?= python3
BIN := .venv/bin
export PATH := $(CURDIR)/.venv/bin:$(PATH)

.PHONY: demo test check bench setup clean
.DEFAULT_GOAL := demo

demo: setup          ## the main job, end to end, with no hardware
	$(BIN)/hubodo demo -o out/demo

test: setup          ## everything that can be proven without hardware
	$(BIN)/python -m pytest

check: setup         ## format, lint, types, generated files, firmware for both boards
	tools/check

bench: setup         ## speed and memory beside the peers, in the same run
	$(BIN)/python tests/bench/bench_decoder.py
	$(BIN)/python tests/bench/bench_recording.py

setup:
	@PYTHON=$(PYTHON) tools/setup

clean:
	rm -rf .venv node_modules out build
