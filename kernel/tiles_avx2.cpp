#include "vector_avx2.h"

#include "gradient.h"
#include "mirror.h"
#include "turned.h"

void raden::shade_tiles_avx2(const Scene& scene, long first_tile, long last_tile) {
    shade_tiles<Avx2>(scene, first_tile, last_tile);
}

void raden::differentiate_tiles_avx2(const Scene& scene, const Gradient& wanted, const Slice& slice) {
    differentiate_tiles<Avx2>(scene, wanted, slice);
}

void raden::shade_turned_tiles_avx2(const Scene& scene, const Turned& turned, long first_tile,
                                      long last_tile) {
    shade_turned_tiles<Avx2>(scene, turned, first_tile, last_tile);
}
