#!/bin/bash -eu
# Builds the targets into $OUT, as OSS-Fuzz asks: the compiled core (libFuzzer) and the readers of files (Atheris).
cmake -S native -B "$WORK/native" -DSCOUP_TESTS=ON -DSCOUP_FUZZING_ENGINE="$LIB_FUZZING_ENGINE"
cmake --build "$WORK/native" --parallel
cp "$WORK/native/fuzz" "$OUT/fuzz_core"

# Without the compiled core and the page: the target above has the one, and no reader needs the other.
SCOUP_WITHOUT_CORE=1 SCOUP_WITHOUT_PAGE=1 pip3 install .
python3 tools/oss_fuzz/fuzz_readers.py --seeds "$WORK/seeds"
(cd "$WORK/seeds" && zip --quiet "$OUT/fuzz_readers_seed_corpus.zip" ./*)
compile_python_fuzzer tools/oss_fuzz/fuzz_readers.py --paths . --collect-all scoup --collect-all scoup_lab
