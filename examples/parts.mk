# Build a field with make: the region sums in parts, some of them at a time, then the field.
#
#     make -f examples/parts.mk -j 4 SCENE=demo/scene FIELD=made.scoup COUNT=16
#
# BUILD: options of scoup build --sums. After a failure, the same line continues: views that are done are not made again.
# Names must not contain spaces.

COUNT ?= 8
THREADS ?= 1
ifeq ($(and $(SCENE),$(FIELD)),)
$(error pass SCENE=FOLDER and FIELD=NAME.scoup)
endif

SUMS := $(FIELD).sums
PARTS := $(foreach number,$(shell seq $(COUNT)),$(SUMS)/part-$(number)-of-$(COUNT).done)

export OMP_NUM_THREADS = $(THREADS)

$(FIELD): $(PARTS)
	scoup build $(SCENE) --sums $(SUMS) --out $@ --overwrite $(BUILD)

$(PARTS): $(SUMS)/part-%-of-$(COUNT).done:
	scoup build $(SCENE) --keep-sums $(SUMS) --part $*/$(COUNT)
	@touch $@
