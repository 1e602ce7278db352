#include "vector_avx2.h"

#include "gradient.h"
#include "shade_tiles.h"

void raden::shade_tiles_avx2(const Scene& scene, long first_tile, long last_tile) {
    shade_tiles<Avx2>(scene, first_tile, last_tile);
}

void raden::differentiate_tiles_avx2(const Scene& scene, const Gradient& wanted, const Slice& slice) {
    differentiate_tiles<Avx2>(scene, wanted, slice);
}
