// Tile after tile of a scene, by what it asks for.
#pragma once
#include "errors.h"
#include "mirror.h"
#include "turned.h"

namespace raden {

template <class AnyTile, class Shade>
void each_tile(const Scene& scene, long first_tile, long last_tile, const Shade& shade) {
    const long across = tiles_per_row(scene);
    for (long i = first_tile; i < last_tile; ++i) {
        const long line = i / across;
        AnyTile tile(scene, line / scene.rows, line % scene.rows, i % across * tile_pixels);
        tile.select_pixels();
        shade(tile);
    }
}

template <class V>
void shade_tiles(const Scene& scene, long first_tile, long last_tile) {
    if (scene.turned.tangent.data)
        each_tile<TurnedTile<V>>(scene, first_tile, last_tile, [](TurnedTile<V>& tile) { tile.shade(); });
    else if (scene.errors.values)
        each_tile<ErrorTile<V>>(scene, first_tile, last_tile, [](ErrorTile<V>& tile) { tile.shade(); });
    else
        each_tile<ShadedTile<V>>(scene, first_tile, last_tile, [&scene](ShadedTile<V>& tile) {
            if (scene.mirror.values)
                look_up_mirror(tile);
            else if (scene.sphere.values)
                tile.look_up();
            else if (scene.lit)
                tile.shade();
            else
                tile.reflect();
        });
    V::fence();
}

}  // namespace raden
