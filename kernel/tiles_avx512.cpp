#include "vector_avx512.h"

#include "gradient.h"
#include "mirror.h"
#include "turned.h"

void raden::shade_tiles_avx512(const Scene& scene, long first_tile, long last_tile) {
    shade_tiles<Avx512>(scene, first_tile, last_tile);
}

void raden::differentiate_tiles_avx512(const Scene& scene, const Gradient& wanted, const Slice& slice) {
    differentiate_tiles<Avx512>(scene, wanted, slice);
}

void raden::shade_turned_tiles_avx512(const Scene& scene, const Turned& turned, long first_tile,
                                      long last_tile) {
    shade_turned_tiles<Avx512>(scene, turned, first_tile, last_tile);
}
