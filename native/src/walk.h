// Walk of rays along their tracks over a terrain: data shared by the handler and the kernels.

#pragma once

#include <cstdint>

namespace jaxgeo {

// One number per ray, or one for all (stride 0).
struct Numbers {
  const double* data;
  int64_t stride;

  double at(int64_t ray) const { return data[ray * stride]; }
};

// Heights at equal steps along a line over the grid, see `LineField`; strides are 0 if shared by all rays.
struct LineField {
  const double *values, *first, *step;
  int64_t nodes, values_stride, first_stride, step_stride;
};

enum class Kind { f64, f32, s8, u8, s16, u16, s32, u32 };

struct Terrain {
  const void* posts;
  Kind kind;
  const bool* voids;
  bool has_void;
  int32_t rows, cols;            // of the array of posts
  int32_t true_rows, true_cols;  // of the posts within the extent
  const uint16_t* bounds;
  int32_t first_texel[32];  // by level; levels above the top repeat it
  int32_t top;
  double base, step;
  Numbers ceiling, void_top, rise;
  const Numbers* constants;
  int32_t constant_count;
  const LineField* lines;
  int32_t line_count;
};

// Tracks as coefficients of row, col and height by power of tau, and where each walk starts. Rays with `here` < 0 are
// left alone: their results are those of a walk that ends without an event.
struct Tracks {
  const double* coefficients[15];
  const int32_t *here, *news;
};

// Results. `news` as in `march.news_of`; `taus`: begin, root and a later place below the surface; `cells`: row, col.
struct Events {
  int32_t* news;
  double* taus[3];
  int32_t* cells[2];
};

// Rows and columns affine in longitude and latitude, see `GeographicGrid`: the centre's place, the sine and cosine of
// its longitude and latitude, the inverse of the steps, and the lengths in m of a step in row and in col.
struct GeographicGrid {
  double row0, col0, sine_lon0, cosine_lon0, sine_lat0, cosine_lat0, inverse[2][2], cell_size[2];
};

// Straight rays (ECEF, by point) and the section of each that a walk covers, see `Way`. `passed`, `length`: that of its
// first track, in m.
struct Rays {
  const double *origins, *directions, *passed, *lengths, *ends, *firsts, *lasts;
  GeographicGrid grid;
};

// Results of rays walked to their ends: as of `Events`, with ranges in m in place of taus; the number of tracks, and
// whether the end of the last one is above the ceiling.
struct Hits {
  int32_t* news;
  double* ranges[3];
  int32_t *cells[2], *tracks;
  bool* is_above;
};

constexpr int64_t CHUNK = 1024;  // rays that one call takes at most

// For each instruction set: walks along given tracks; and along those that rays need, one after the other, where the
// first ones are given for rays with `here` >= 0 and -1 requests one (-2: a ray without a walk).
#define JAXGEO_DECLARE_WALKS(name)                                                                               \
  namespace name {                                                                                               \
  void walk(const Terrain&, const Tracks&, const Events&, int64_t first, int64_t last);                          \
  void follow(const Terrain&, const Rays&, const Tracks&, const Hits&, int64_t first, int64_t last);             \
  }
JAXGEO_DECLARE_WALKS(plain)
JAXGEO_DECLARE_WALKS(avx2)
JAXGEO_DECLARE_WALKS(avx512)
#undef JAXGEO_DECLARE_WALKS

}  // namespace jaxgeo
