#!/usr/bin/env bash
# Every number of docs/calibration.md, docs/performance.md, docs/baselines.md and docs/policies.md, from nothing, in order.
# Many hours on two cores; every step can be stopped and run again. Run it alone on the machine: most of it measures time.
# Needs the extras test, report, openvino and ray (pip install -e ".[test,report,openvino,ray]"), and what the comments
# name.
set -euo pipefail
cd "$(dirname "$0")/.."
results=benchmarks/results

rema scenarios v1 # lists that are already there are kept
python benchmarks/calibrate.py --json $results/calibration.json
python benchmarks/sensitivity.py --episodes 200 --json $results/sensitivity.json
python benchmarks/sim_throughput.py --json $results/sim_throughput.json
python benchmarks/noise.py --json $results/noise.json
python benchmarks/shortcuts.py --json $results/shortcuts.json
python benchmarks/memory.py --json $results/memory.json
python benchmarks/determinism.py --episodes 60 --others 400 --json $results/determinism.json
python benchmarks/byte_identity.py --episodes 100 --json $results/byte_identity.json

# Releases never change: these two came of `rema collect manifests/plans/rema-sample.toml` (and rema-mini.toml) before the
# policies and the simulator had their present digests, so the same command refuses now to write others under their names.
rema verify rema-sample
rema verify rema-mini
python benchmarks/open.py --json $results/open.json
python benchmarks/sampler.py --json $results/sampler.json
python benchmarks/size.py --json $results/size.json
python benchmarks/read.py --release rema-mini --steps 1000 --samples 512 --repeats 3 --seconds 1 --json $results/read.json # in an environment with LeRobot and Minari, see the script
python benchmarks/download.py --json $results/download.json # with nginx on the path
python benchmarks/robomimic_reader.py --json $results/robomimic_reader.json # pip install robomimic, see the script
for format in lerobot minari rlds hf; do # each reader in an environment of its own, see the scripts
  python benchmarks/${format}_reader.py --python environments/$format/bin/python --release rema-sample --json $results/${format}_reader.json
done
for format in rlds lerobot hf minari hdf5; do
  python benchmarks/formats.py --format $format --json $results/formats_$format.json
done
for harness in lerobot vla-eval inspect-robots; do # as the readers
  python benchmarks/harnesses.py --harness $harness --python environments/$harness/bin/python --json $results/harness_${harness//-/_}.json
done

rema rounds manifests/plans/rema-v0.toml # stages that are done are kept; its network after round 2 picks tools
rema scenarios v2 --keep grasp_grasp_push --picker tae --checkpoint releases/checkpoints/rema-v0/round-2 --device openvino
rema rounds manifests/plans/rema-v1.toml --register
rema rounds manifests/plans/rema-v1-tool2.toml --register # the networks of the fifth task
networks=releases/checkpoints/rema-v1

tasks="grasp push grasp_push grasp_grasp"
for task in $tasks; do
  for policy in random scripted tae-separate tae-joint; do
    rema evaluate $policy --task $task --device openvino
    case $task in *_*) rema evaluate $policy --task $task --device openvino --protocol end-to-end ;; esac
  done
done
for policy in random scripted tae-joint; do
  rema evaluate $policy --task grasp_grasp_push --device openvino
done
for round in 1 2; do
  rema evaluate tae --checkpoint $networks/round-$round --task grasp --device openvino \
    --output runs/rema-v1-round-$round-grasp-conditional
done
for task in $tasks; do
  rema evaluate tae --checkpoint $networks/round-3 --task $task --device openvino \
    --output runs/rema-v1-round-3-$task-conditional
done
python benchmarks/ablation.py --output runs/ablation --device cuda --ways as-planned,not-turned,not-turned-slower \
  --json $results/ablation.json
ways=as-planned,another-seed,300-updates,1000-updates,balanced-on-average,wrong-labels,finer-cells,displaced
OMP_NUM_THREADS=1 python benchmarks/ablation.py --output runs/ablation-cpu --ways $ways --episodes 2000 \
  --json $results/ablation_cpu.json
OMP_NUM_THREADS=1 python benchmarks/methods.py --output runs/methods --train 1/1
python benchmarks/methods.py --output runs/methods --json $results/methods.json
OMP_NUM_THREADS=1 python benchmarks/fine.py --output runs/fine --train 1/1
python benchmarks/fine.py --output runs/fine --json $results/fine.json
python benchmarks/examples.py --json $results/examples.json # pip install scikit-learn
python benchmarks/examples.py --page
python benchmarks/baselines.py --maps --runs runs/*
for task in grasp push grasp_push grasp_grasp grasp_grasp_push; do
  rema scenarios hard-v1 --suite --task $task # a list that is there already is kept
done
python benchmarks/suite_page.py --pictures
for task in grasp push; do
  for policy in random scripted examples/my_policy.py tae-separate tae-joint; do
    rema evaluate $policy --task $task --suite hard-v1
    rema evaluate $policy --task $task --fresh 2026
  done
done
python benchmarks/calibration_report.py --runs runs/{random,scripted}-*-conditional
python benchmarks/full_run.py --tasks grasp,push --json $results/full_run.json
for run in runs/{random,scripted,tae-separate,tae-joint}-*; do
  entry="manifests/leaderboard/$(basename "$run").json" # an entry that is there already is of another run of the same
  [ -e "$entry" ] || rema submit "$run" --output "$entry"
done
python benchmarks/leaderboard.py
python benchmarks/model_cards.py
python benchmarks/command_line.py
python benchmarks/train.py --tried --json $results/train.json
python benchmarks/train.py --device cuda --batches 8,32,128,512,2048 --updates 8 --json $results/train_cuda.json # on a GPU
python benchmarks/infer.py --checkpoint releases/checkpoints/rema-v1/joint --runtimes --json $results/infer.json
python benchmarks/half_precision.py --checkpoint releases/checkpoints/rema-v1/joint --scenarios 250 --json $results/half_precision.json

python benchmarks/isolation.py --run runs/random-grasp-conditional --json $results/isolation.json
python benchmarks/hostile.py --json $results/hostile.json
python benchmarks/kills.py --json $results/kills.json
python benchmarks/kills_rounds.py --json $results/kills_rounds.json
python benchmarks/forgeries.py --json $results/forgeries.json
python benchmarks/verify_entry.py --check --json $results/verify_entry.json
python benchmarks/mutations.py --json $results/mutations.json
python benchmarks/signals.py --json $results/signals.json
python benchmarks/coverage.py --json $results/coverage.json
python benchmarks/report_page.py --run runs/random-grasp-conditional --json $results/report_page.json # with Chromium
python benchmarks/view.py --pictures docs/images --json $results/view.json # with Chromium
python benchmarks/scaling.py --json $results/scaling.json
python benchmarks/scaling_report.py
python benchmarks/report.py
python benchmarks/gallery.py
