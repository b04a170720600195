# Every target does its own set-up; only Python 3.11 or newer is required (PYTHON=/path/to/python3.11 for another).
PYTHON ?=
BIN := .venv/bin
export PATH := $(CURDIR)/.venv/bin:$(PATH)
# The matrices here are small: threads of a matrix library cost more time than they save.
export OPENBLAS_NUM_THREADS := 1
# Hundreds of processes import the same files, so their bytecode is cached; a new checkout is compiled by one
# process, instead of by four that start at the same time.
unexport PYTHONDONTWRITEBYTECODE
# Hypothesis would import the plugins of other packages, such as trio, into every process.
export HYPOTHESIS_NO_PLUGINS := 1

.PHONY: demo test repeat quick check docs package chip power bench soak papers accuracy road sensitivity gap-matrix gap-limit gap-reliability gap-several gap-beyond gap-rides gap-real gap-semi mutants faults fuzz load fleet interop audit screenshots browser compiler setup clean
.DEFAULT_GOAL := demo

demo: setup          ## the main job end to end, without hardware
	$(BIN)/hubodo demo -o out/demo

test: setup browser compiler  ## all tests that need no hardware
	@test -d tests/host/fuse/__pycache__ || $(BIN)/python -m pytest --collect-only --quiet >/dev/null
	$(BIN)/python -m pytest --numprocesses 4 --dist loadfile --no-loadscope-reorder -m "not repeat and not release"

repeat: setup browser compiler ## further seeds, chips and drives of the tests, which make test runs once; prints them
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder \
		-m "repeat or hypothesis" --hypothesis-profile wide -rP

QUICK := tests/protocol tests/host/effects tests/host/model tests/host/log tests/host/gap tests/host/fuse
# Excluded: tests of the graph, of many noisy drives and complete recordings, and recipes, which take most of the time.
SLOW := graph_* wheel_calibration* wheel_car* wheel_clipped* wheel_consistency* wheel_overconfidence* wheel_rollback* \
	surface_speeds* ranges* node_bias* gap_watch* gap_refinement* gap_null_distribution* gap_explanation* gap_process_noise* *add_* field*
quick: setup         ## the core in a minute: protocol, effects, model, log, gap, wheel filter
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder -m "not real_time and not repeat" \
		$(foreach name,$(SLOW),--ignore-glob='*/test_$(name)') $(QUICK)

check: setup         ## format, lint, types, generated files, documentation, package, firmware for both boards
	tools/check

docs: setup          ## build the documentation, and run its notebook, into out/docs: open index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --config-file host/mkdocs.yml

package: setup       ## build the package, install it from wheels into a new environment, and run the demo there
	tools/try_package

chip: setup          ## the firmware on an emulated Pico: losses, processor, heap, time stamps; about three minutes
	$(BIN)/python tests/chip/chip.py --seconds 60

power: setup         ## battery life: time awake on the emulated Pico, currents with their sources, two cells
	$(BIN)/python tests/chip/power.py

ble: setup           ## Bluetooth: losses, delay and capacity of two nodes by connection interval, MTU, PHY and loss; two minutes
	$(BIN)/python tests/chip/ble.py

BENCHES := decoder reading recording import filters hour fuse live allan gap web
bench: setup         ## speed and memory compared with other packages in the same run; a table, and what has become slower
	@missed=0; for name in $(BENCHES); do $(BIN)/python tests/bench/bench_$$name.py || missed=1; done; \
		$(BIN)/python tests/bench/table.py || missed=1; exit $$missed

HOURS := 3
soak: setup          ## memory during hours of recording in virtual time; about five minutes (HOURS=24: forty; SOAK="--outage 600": a node without power for ten minutes of each hour)
	$(BIN)/python tests/soak/soak.py --hours $(HOURS) $(SOAK)

papers: setup        ## results of four papers compared with ours
	$(BIN)/python tests/papers/shah.py
	$(BIN)/python tests/papers/barshan.py
	$(BIN)/python tests/papers/avrutov.py
	$(BIN)/python tests/papers/avrutov_separation.py
	$(BIN)/python tests/papers/robert.py

accuracy: setup      ## accuracy over many seeded drives and records; about seventeen minutes
	$(BIN)/python tests/accuracy/odometry.py
	$(BIN)/python tests/accuracy/mixed.py
	$(BIN)/python tests/accuracy/late_node.py
	$(BIN)/python tests/accuracy/gnss.py
	$(BIN)/python tests/accuracy/live_map.py
	$(BIN)/python tests/accuracy/set_pose.py
	$(BIN)/python tests/accuracy/compass.py
	$(BIN)/python tests/accuracy/allan_truth.py 40
	$(BIN)/python tests/accuracy/warmup_forms.py
	$(BIN)/python tests/accuracy/warmup_temperature.py
	$(BIN)/python tests/accuracy/north_found.py
	$(BIN)/python tests/accuracy/north_methods.py
	$(BIN)/python tests/accuracy/north_temperature.py
	$(BIN)/python tests/accuracy/stated_inputs.py
	$(BIN)/python tests/accuracy/heading_rests.py
	$(BIN)/python tests/accuracy/odd_records.py
	$(BIN)/python tests/accuracy/poses.py
	$(BIN)/python tests/accuracy/imu_records.py
	$(BIN)/python tests/accuracy/imu_means.py
	$(BIN)/python tests/accuracy/imu_temperature.py
	$(BIN)/python tests/accuracy/rate_table.py
	$(BIN)/python tests/accuracy/pose_plan.py
	$(BIN)/python tests/accuracy/node_bias.py

road: setup          ## a real car, standstills, outages, slip, saturated sensors, calibration; about forty minutes
	$(BIN)/python tests/accuracy/car.py
	$(BIN)/python tests/accuracy/wheel_ins.py
	$(BIN)/python tests/accuracy/car_gnss.py
	$(BIN)/python tests/accuracy/car_outage.py
	$(BIN)/python tests/accuracy/scales.py
	$(BIN)/python tests/accuracy/rests.py
	$(BIN)/python tests/accuracy/idling.py
	$(BIN)/python tests/accuracy/silence.py
	$(BIN)/python tests/accuracy/dropouts.py
	$(BIN)/python tests/accuracy/clipped.py
	$(BIN)/python tests/accuracy/spikes.py
	$(BIN)/python tests/accuracy/fast_cars.py
	$(BIN)/python tests/accuracy/damaged_samples.py
	$(BIN)/python tests/accuracy/slip.py
	$(BIN)/python tests/accuracy/wheel_calibration.py

sensitivity: setup   ## each constant of the wheel filter at half and twice its value; takes hours, resumes after an interruption
	$(BIN)/python tests/accuracy/sensitivity.py

gap-matrix: setup    ## hidden effects found, missed and falsely named, on the test seeds; about seventy minutes
	$(BIN)/python tests/gap_matrix/matrix.py --seeds test

gap-limit: setup     ## smallest size of each effect that is named, compared with detection and identification by an oracle; about twenty minutes
	$(BIN)/python tests/gap_matrix/limit/gap_limit.py --seed 412000

gap-reliability: setup ## share of correct names by stated confidence in two thousand short logs, on the test seeds; about thirty minutes
	$(BIN)/python tests/gap_matrix/judge/reliability.py --seeds test

gap-several: setup   ## three to five effects hidden at once, searched in several orders, on the test seeds; about ten minutes
	$(BIN)/python tests/gap_matrix/judge/several.py --seeds test

gap-beyond: setup    ## scaffolding of eight effects outside the vocabulary, and comparison of two drives of one vehicle; about fifteen minutes
	$(BIN)/python tests/gap_matrix/judge/scaffolded.py --seeds 20:23
	$(BIN)/python tests/gap_matrix/judge/two_drives.py --first 100 --seconds 60

gap-real: setup      ## effects injected into the samples of real drives of a car, with a model learnt on the other drive; about an hour
	$(BIN)/python tests/gap_real/real.py

gap-semi: setup      ## effects hidden in simulated drives with the residuals of real drives as noise; about twenty minutes
	$(BIN)/python tests/gap_real/semi_real.py

gap-rides: setup     ## five effects hidden in virtual nodes, and a recording of a real wheelchair; about four minutes
	$(BIN)/python tests/signal_path/hidden.py
	$(BIN)/python tests/replay/wheelchair_gap.py

mutants: setup       ## mutation testing of the core: the share of mutants that the tests kill; an interrupted run continues
	$(BIN)/python tests/mutants/score.py --seed 1 --count 125 --demand 0.85

faults: setup        ## the table of faults, all tested, including two hundred kills, floods and a thousand mutated files; about twenty minutes
	$(BIN)/python tests/faults/faults.py --kills 200

SECONDS ?= 600
fuzz: setup          ## each reader on mutated files for SECONDS (600), within limits of memory and time (FUZZ="--reader hdf5 --files 1000")
	$(BIN)/python tests/fuzz/fuzz.py --seconds $(SECONDS) $(FUZZ)

load: setup          ## 64 nodes on one recorder for five minutes, then more until one fails; requires a quiet machine
	$(BIN)/python tests/load/load.py
	$(BIN)/python tests/load/idle_connections.py
	$(BIN)/python tests/load/idle_connections.py --slow --connections 100

interop: setup       ## hubodo as a ROS 2 node, received by Fast DDS in C++: content, quality of service, rate; latency at four nodes
	@command -v g++ >/dev/null && test -e /usr/include/fastdds || tools/debian_packages g++ libfastrtps-dev
	@mkdir -p out/interop
	g++ -std=c++17 -O1 -o out/interop/subscriber tests/interop/subscriber.cpp -lfastrtps -lfastcdr
	$(BIN)/python tests/interop/interop.py
	$(BIN)/python tests/interop/latency.py

audit: setup         ## known vulnerabilities of the installed packages, from the advisories of PyPI and npm
	$(BIN)/python -m venv out/audit && out/audit/bin/pip install --quiet --disable-pip-version-check pip-audit
	out/audit/bin/pip-audit --requirement requirements.lock --no-deps --disable-pip
	npm audit

fleet: setup         ## two thousand logs of five minutes through hubodo batch, a second worker, an index of a year; about twenty minutes, 6 GB
	$(BIN)/python tests/batch/fleet.py

screenshots: setup browser ## every page, also live page and recordings, in Chromium, wide and narrow, light and dark, and the images of the README; about three minutes
	$(BIN)/python tests/pages/screenshots.py --update

browser:             ## Chromium for the tests of pages, installed if missing and possible
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null || tools/debian_packages chromium chromium-driver || true

compiler:            ## C compiler for the independent decoder in tests; likewise
	@command -v cc >/dev/null || tools/debian_packages gcc libc6-dev || true

setup:
	@PYTHON="$(PYTHON)" tools/setup

clean:
	rm -rf .venv node_modules out build
