#include "vector_portable.h"

#include "gradient.h"
#include "shade_tiles.h"

void raden::shade_tiles_portable(const Scene& scene, long first_tile, long last_tile) {
    shade_tiles<Portable>(scene, first_tile, last_tile);
}

void raden::differentiate_tiles_portable(const Scene& scene, const Gradient& wanted, const Slice& slice) {
    differentiate_tiles<Portable>(scene, wanted, slice);
}
