# Two commands are all a newcomer needs: `make demo` and `make test`. Both do the set-up themselves.
PY := .venv/bin/python
STAMP := .venv/.ready
export HF_HUB_OFFLINE ?= 1
export TOKENIZERS_PARALLELISM ?= false

.PHONY: help setup demo test thorough lint docs properties faults rollout-faults fuzz ci canary clean lock

help:
	@echo "make setup   fill .venv (Python 3.12, locked dependencies)"
	@echo "make demo    record, train, roll out, score: a page that plays three sensors side by side, 4 minutes on a laptop"
	@echo "make test    lint, types and the test suite, 15 minutes on 2 cores"
	@echo "make docs    the pages of docs/ as a site in site/, every link checked, in seconds and without the network"
	@echo "make properties  property tests with ten times as many examples, random ones"
	@echo "make fuzz    100,000 injured inputs into each parser of bytes, 2,000 into each reader of files (half an hour)"
	@echo "make faults  31 faults of the stand-in arm, ten times each, and 2,100 sessions of stops (40 minutes)"
	@echo "make rollout-faults  15 kinds of fault in LeRobot's own rollout over the stand-in, ten times each (30 minutes)"
	@echo "make canary  LEROBOT=/path: the tests that meet LeRobot, against a checkout of its source (25 minutes)"
	@echo "make thorough  the tests that repeat, take long or are of benchmarks, 20 minutes"
	@echo "make ci      make test and make thorough, then the wheel in a fresh environment"

setup: $(STAMP)

$(STAMP): requirements.lock requirements-clients.lock pyproject.toml scripts/setup.sh
	@bash scripts/setup.sh
	@touch $(STAMP)

demo: setup
	@$(PY) -m uniforce_cli.main demo

lint: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

test: setup lint
	@$(PY) -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not realtime and not thorough"; first=$$?; \
	$(PY) -m pytest -m "realtime and not thorough"; second=$$?; \
	echo "first half, beside each other: $$([ $$first -eq 0 ] && echo passed || echo FAILED)"; \
	echo "second half, against the clock: $$([ $$second -eq 0 ] && echo passed || echo FAILED)"; \
	[ $$first -eq 0 ] && [ $$second -eq 0 ]

# longer forms of the same tests, what repeats, and benchmarks; one after the other, for some hold a clock
thorough: setup
	$(PY) -m pytest -m thorough

# NO_MKDOCS_2_WARNING: the theme's notice about its successor
docs: setup
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

properties: setup
	$(PY) -m pytest -m hypothesis --hypothesis-profile random

faults: setup
	$(PY) -m benchmarks.trust.hostile times=10 out=docs/results/trust.json & \
	$(PY) -m benchmarks.trust.stop_sessions out=docs/results/trust.json; sessions=$$?; \
	wait $$! && [ $$sessions -eq 0 ]

rollout-faults: setup
	$(PY) -m benchmarks.trust.rollout_faults times=10 out=docs/results/trust.json

fuzz: setup
	UNIFORCE_FUZZ_INPUTS=$${UNIFORCE_FUZZ_INPUTS:-100000} UNIFORCE_FUZZ_FILES=$${UNIFORCE_FUZZ_FILES:-2000} \
	  UNIFORCE_FUZZ_RESULTS=docs/results/fuzz.json $(PY) -m pytest tests/fuzz --timeout 0

ci: test thorough
	bash scripts/check_wheel.sh

LOCK = $$(command -v uv || echo .venv-uv/bin/uv) pip compile --python-version 3.12 --no-annotate --no-header --no-emit-index-url \
	  --no-emit-find-links --generate-hashes

lock:
	$(LOCK) --override scripts/lock_overrides.txt --group dev --group docs pyproject.toml -o requirements.lock
	$(LOCK) --constraint requirements.lock --group clients -o requirements-clients.lock

# LEROBOT=/path/to/a/checkout of LeRobot: its source stands in front of the installed one, nothing is installed. It tells
# which tests of ours that LeRobot breaks; docs/next_lerobot.md says why each does.
LEROBOT ?= ../lerobot
CANARY := tests/policies tests/datasets tests/envs tests/robots tests/goldens tests/scripts/test_compat.py tests/test_end_to_end.py tests/test_lerobot_commands.py

canary: setup
	@test -f $(LEROBOT)/src/lerobot/__init__.py || { echo "canary: expected a checkout of LeRobot, got $(LEROBOT). Give LEROBOT=/path."; exit 2; }
	PYTHONPATH=$(abspath $(LEROBOT))/src $(PY) -m pytest --timeout 600 $(CANARY)

clean:
	rm -rf .venv outputs site .mypy_cache .ruff_cache .pytest_cache
