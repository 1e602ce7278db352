// Tile after tile of a scene, by what it asks for.
#pragma once
#include "errors.h"
#include "mirror.h"
#include "turned.h"

namespace raden {

template <class AnyTile, class Shade>
void each_tile(const Scene& scene, long first_tile, long last_tile, const Shade& shade_one) {
    const auto shade = [&](AnyTile& tile) RADEN_ONCE { shade_one(tile); };
    const long across = tiles_per_row(scene);
    // not where a tile leaves lights out by the box around its pixels, which is to be small
    const bool gathers = (scene.mask.data || scene.index.data) && !scene.bounded;
    Gathered left;
    for (long i = first_tile; i < last_tile; ++i) {
        const long line = i / across, image = line / scene.rows, row = line % scene.rows, column = i % across;
        const auto shade_gathered = [&](int least) {
            while (left.count >= least) {
                AnyTile tile(scene, image, row, left.first);
                tile.take(left);
                shade(tile);
            }
        };
        AnyTile tile(scene, image, row, column * tile_pixels);
        tile.select_pixels();
        if (gathers && tile.is_cut()) {
            if (left.table != tile.table) shade_gathered(1);
            tile.leave(left);
        }
        shade(tile);
        shade_gathered(column + 1 == across || i + 1 == last_tile ? 1 : tile_pixels);
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
