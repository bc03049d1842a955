# Build a field in shards with make, some of them at a time, and merge them:
#
#     make -f examples/shards.mk -j 4 SCENE=demo/scene FIELD=made.scoup COUNT=16
#
# BUILD and MERGE: further options of scoup build --shard and of scoup merge. After a failure, the same line goes on; it
# makes only what is missing. Names with spaces are nothing for make.

COUNT ?= 8
THREADS ?= 1
ifeq ($(and $(SCENE),$(FIELD)),)
$(error give SCENE=FOLDER and FIELD=NAME.scoup)
endif

SHARDS := $(foreach number,$(shell seq $(COUNT)),$(FIELD).$(number)-of-$(COUNT).sums)

export OMP_NUM_THREADS = $(THREADS)

$(FIELD): $(SHARDS)
	scoup merge $^ --out $@ --overwrite $(MERGE)

$(SHARDS): $(FIELD).%-of-$(COUNT).sums:
	scoup build $(SCENE) --out $(FIELD) --shard $*/$(COUNT) $(BUILD)
