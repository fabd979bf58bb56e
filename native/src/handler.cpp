// The handler that XLA calls: reads its buffers, chooses the kernels for this processor, and shares rays among threads.

#include <atomic>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "walk.h"
#include "xla/ffi/api/ffi.h"

namespace jaxgeo {
namespace {

namespace ffi = xla::ffi;

// The kernels of one instruction set.
struct Kernels {
  decltype(&plain::walk) walk;
  decltype(&plain::follow) follow;
};

// Those with the widest vectors that this processor has, or that JAXGEO_NATIVE (plain, avx2) allows.
Kernels best_kernels() {
#if defined(JAXGEO_X86)
  const char* given = std::getenv("JAXGEO_NATIVE");
  const std::string limit = given == nullptr ? "" : given;
  if (limit == "plain") return {plain::walk, plain::follow};
  __builtin_cpu_init();
  if (limit != "avx2" && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512bw"))
    return {avx512::walk, avx512::follow};
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return {avx2::walk, avx2::follow};
#endif
  return {plain::walk, plain::follow};
}

const Kernels& kernels() {
  static const Kernels best = best_kernels();
  return best;
}

// Chunks of a call, taken one by one by the calling thread and by those of the pool.
struct Work {
  std::atomic<int64_t> next{0};
  int64_t chunks = 0, done = 0;
  std::mutex mutex;
  std::condition_variable finished;

  template <class Each>
  void run(const Each& each) {
    int64_t count = 0;
    for (int64_t chunk; (chunk = next.fetch_add(1)) < chunks; ++count) each(chunk);
    if (count == 0) return;
    std::lock_guard<std::mutex> lock(mutex);
    done += count;
    if (done == chunks) finished.notify_all();
  }

  void wait() {
    std::unique_lock<std::mutex> lock(mutex);
    finished.wait(lock, [this] { return done == chunks; });
  }
};

// Call a function of the first and last ray of a chunk for all chunks.
template <class Each>
void by_chunks(ffi::ThreadPool& pool, int64_t rays, const Each& of_rays) {
  const int64_t chunks = (rays + CHUNK - 1) / CHUNK;
  const auto each = [=](int64_t chunk) {
    const int64_t last = (chunk + 1) * CHUNK;
    of_rays(chunk * CHUNK, last < rays ? last : rays);
  };
  const int64_t threads = pool.num_threads(), helpers = (chunks < threads ? chunks : threads) - 1;
  if (helpers <= 0) {
    for (int64_t chunk = 0; chunk < chunks; ++chunk) each(chunk);
    return;
  }
  // A task that starts after all is done finds no chunk left, and touches nothing else.
  const auto work = std::make_shared<Work>();
  work->chunks = chunks;
  for (int64_t k = 0; k < helpers; ++k) pool.Schedule([work, each] { work->run(each); });
  work->run(each);
  work->wait();
}

template <class T>
constexpr ffi::DataType TYPE = ffi::DataType::INVALID;
template <>
constexpr ffi::DataType TYPE<double> = ffi::DataType::F64;
template <>
constexpr ffi::DataType TYPE<int32_t> = ffi::DataType::S32;
template <>
constexpr ffi::DataType TYPE<uint16_t> = ffi::DataType::U16;
template <>
constexpr ffi::DataType TYPE<bool> = ffi::DataType::PRED;

// The buffers of a call, one after the other, for so many rays; `is_sound` is false from the first one on that is missing,
// too small, or of another type.
class Buffers {
 public:
  Buffers(ffi::RemainingArgs args, int64_t rays) : args_(args), rays_(rays) {}

  ffi::AnyBuffer next() {
    auto buffer = args_.get<ffi::AnyBuffer>(number_++);
    if (!buffer.has_error()) return *buffer;
    is_sound_ = false;
    static XLA_FFI_Buffer nothing{};
    return ffi::AnyBuffer(&nothing);
  }

  // At least so many items.
  template <class T>
  const T* data(int64_t count) {
    return items<T>(next(), count);
  }

  // At least so many items for each ray.
  template <class T>
  const T* of_rays(int64_t each = 1) {
    return data<T>(each * rays_);
  }

  template <class T>
  T one() {
    const T* value = data<T>(1);
    return is_sound_ ? *value : T{};
  }

  // One number per ray, or one for all.
  Numbers numbers() {
    const auto buffer = next();
    const int64_t stride = buffer.dimensions().size() > 0 ? 1 : 0;
    return {items<double>(buffer, stride > 0 ? rays_ : 1), stride};
  }

  LineField line() {
    const auto values = next(), first = next(), step = next();
    const int64_t nodes = values.dimensions().size() > 0 ? values.dimensions().back() : 0;
    is_sound_ &= nodes > 0;
    LineField line{nullptr, nullptr, nullptr, nodes, 0, 0, 0};
    line.values = each(values, nodes, line.values_stride);
    line.first = each(first, 2, line.first_stride);
    line.step = each(step, 2, line.step_stride);
    return line;
  }

  bool is_sound() const { return is_sound_; }

 private:
  template <class T>
  const T* items(const ffi::AnyBuffer& buffer, int64_t count) {
    is_sound_ = is_sound_ && buffer.element_type() == TYPE<T> && static_cast<int64_t>(buffer.element_count()) >= count;
    return static_cast<const T*>(buffer.untyped_data());
  }

  // So many numbers for each ray, or for all.
  const double* each(const ffi::AnyBuffer& buffer, int64_t count, int64_t& stride) {
    stride = buffer.dimensions().size() > 1 ? count : 0;
    return items<double>(buffer, stride > 0 ? count * rays_ : count);
  }

  ffi::RemainingArgs args_;
  size_t number_ = 0;
  int64_t rays_;
  bool is_sound_ = true;
};

bool kind_of(ffi::DataType type, Kind* kind) {
  switch (type) {
    case ffi::DataType::F64: *kind = Kind::f64; return true;
    case ffi::DataType::F32: *kind = Kind::f32; return true;
    case ffi::DataType::S8: *kind = Kind::s8; return true;
    case ffi::DataType::U8: *kind = Kind::u8; return true;
    case ffi::DataType::S16: *kind = Kind::s16; return true;
    case ffi::DataType::U16: *kind = Kind::u16; return true;
    case ffi::DataType::S32: *kind = Kind::s32; return true;
    case ffi::DataType::U32: *kind = Kind::u32; return true;
    default: return false;
  }
}

// Texels before each level of a pyramid over the cells of an array of posts; their number in all is returned.
int64_t levels_of(Terrain& terrain) {
  int32_t rows = terrain.rows - 1, cols = terrain.cols - 1, first = 0;
  terrain.top = 0;
  for (int level = 0; level < 32; ++level) {
    terrain.first_texel[level] = first;
    if (rows == 1 && cols == 1) continue;
    first += rows * cols;
    rows = (rows + 1) / 2;
    cols = (cols + 1) / 2;
    terrain.top = level + 1;
  }
  return first + 1;
}

const char* const OTHER_ARRAYS = "a native search was called with arrays of other sizes or types than it takes";

// A terrain, and what holds the parts of its field.
struct Ground {
  Terrain terrain{};
  std::vector<Numbers> constants;
  std::vector<LineField> lines;
};

ffi::Error read_ground(Buffers& buffers, int64_t constants, int64_t lines, Ground& ground) {
  Terrain& terrain = ground.terrain;
  const auto posts = buffers.next();
  if (!buffers.is_sound()) return ffi::Error::InvalidArgument(OTHER_ARRAYS);
  const bool is_grid = posts.dimensions().size() == 2 && posts.dimensions()[0] > 1 && posts.dimensions()[1] > 1;
  if (!is_grid || !kind_of(posts.element_type(), &terrain.kind))
    return ffi::Error::InvalidArgument("the posts of a native search must be an array of heights (rows, cols)");
  terrain.posts = posts.untyped_data();
  terrain.rows = static_cast<int32_t>(posts.dimensions()[0]);
  terrain.cols = static_cast<int32_t>(posts.dimensions()[1]);
  terrain.voids = buffers.data<bool>(static_cast<int64_t>(posts.element_count()));
  terrain.has_void = buffers.one<bool>();
  const int32_t* extent = buffers.data<int32_t>(2);
  if (!buffers.is_sound()) return ffi::Error::InvalidArgument(OTHER_ARRAYS);
  terrain.true_rows = extent[0];
  terrain.true_cols = extent[1];
  terrain.bounds = buffers.data<uint16_t>(levels_of(terrain));
  terrain.base = buffers.one<double>();
  terrain.step = buffers.one<double>();
  terrain.ceiling = buffers.numbers();
  terrain.void_top = buffers.numbers();
  terrain.rise = {nullptr, 0};
  if (constants + lines > 0) terrain.rise = buffers.numbers();
  for (int64_t k = 0; k < constants; ++k) ground.constants.push_back(buffers.numbers());
  for (int64_t k = 0; k < lines; ++k) ground.lines.push_back(buffers.line());
  terrain.constants = ground.constants.data();
  terrain.constant_count = static_cast<int32_t>(constants);
  terrain.lines = ground.lines.data();
  terrain.line_count = static_cast<int32_t>(lines);
  return buffers.is_sound() ? ffi::Error::Success() : ffi::Error::InvalidArgument(OTHER_ARRAYS);
}

Tracks read_tracks(Buffers& buffers) {
  Tracks tracks;
  for (auto& coefficients : tracks.coefficients) coefficients = buffers.of_rays<double>();
  tracks.here = buffers.of_rays<int32_t>();
  tracks.news = buffers.of_rays<int32_t>();
  return tracks;
}

GeographicGrid read_grid(Buffers& buffers) {
  const double *rowcol0 = buffers.data<double>(2), *lonlat0 = buffers.data<double>(2);
  const double *step = buffers.data<double>(4), *cell_size = buffers.data<double>(2);
  if (!buffers.is_sound()) return {};
  const double shrinking = 1.0 / (step[0] * step[3] - step[1] * step[2]);
  return {rowcol0[0],
          rowcol0[1],
          std::sin(lonlat0[0]),
          std::cos(lonlat0[0]),
          std::sin(lonlat0[1]),
          std::cos(lonlat0[1]),
          {{step[3] * shrinking, -step[1] * shrinking}, {-step[2] * shrinking, step[0] * shrinking}},
          {cell_size[0], cell_size[1]}};
}

using Doubles = ffi::Result<ffi::Buffer<ffi::F64>>;
using Integers = ffi::Result<ffi::Buffer<ffi::S32>>;
using Flags = ffi::Result<ffi::Buffer<ffi::PRED>>;

ffi::Error first_events(ffi::ThreadPool pool, ffi::RemainingArgs args, Integers news, Doubles begin, Doubles root,
                        Doubles below, Integers row, Integers col, int64_t constants, int64_t lines) {
  const int64_t count = static_cast<int64_t>(news->element_count());
  Buffers buffers(args, count);
  const Tracks tracks = read_tracks(buffers);
  Ground ground;
  const ffi::Error error = read_ground(buffers, constants, lines, ground);
  if (error.failure()) return error;
  const Events events = {news->typed_data(),
                         {begin->typed_data(), root->typed_data(), below->typed_data()},
                         {row->typed_data(), col->typed_data()}};
  const Terrain terrain = ground.terrain;
  by_chunks(pool, count,
            [=](int64_t first, int64_t last) { kernels().walk(terrain, tracks, events, first, last); });
  return ffi::Error::Success();
}

ffi::Error first_hits(ffi::ThreadPool pool, ffi::RemainingArgs args, Integers news, Doubles begin, Doubles root,
                      Doubles below, Integers row, Integers col, Integers track_count, Flags is_above,
                      int64_t constants, int64_t lines) {
  const int64_t count = static_cast<int64_t>(news->element_count());
  Buffers buffers(args, count);
  Rays rays{};
  for (const double** points : {&rays.origins, &rays.directions}) *points = buffers.of_rays<double>(3);
  for (const double** numbers : {&rays.passed, &rays.lengths, &rays.ends, &rays.firsts, &rays.lasts})
    *numbers = buffers.of_rays<double>();
  rays.grid = read_grid(buffers);
  const Tracks tracks = read_tracks(buffers);
  Ground ground;
  const ffi::Error error = read_ground(buffers, constants, lines, ground);
  if (error.failure()) return error;
  const Hits hits = {news->typed_data(),
                     {begin->typed_data(), root->typed_data(), below->typed_data()},
                     {row->typed_data(), col->typed_data()},
                     track_count->typed_data(),
                     is_above->typed_data()};
  const Terrain terrain = ground.terrain;
  by_chunks(pool, count,
            [=](int64_t first, int64_t last) { kernels().follow(terrain, rays, tracks, hits, first, last); });
  return ffi::Error::Success();
}

// What both handlers take and return: news, begin, root, a later place below the surface, row and column.
auto events_bound() {
  using Doubles = ffi::Buffer<ffi::F64>;
  using Integers = ffi::Buffer<ffi::S32>;
  return ffi::Ffi::Bind()
      .Ctx<ffi::ThreadPool>()
      .RemainingArgs()
      .Ret<Integers>()
      .Ret<Doubles>()
      .Ret<Doubles>()
      .Ret<Doubles>()
      .Ret<Integers>()
      .Ret<Integers>();
}

}  // namespace
}  // namespace jaxgeo

#pragma GCC visibility push(default)
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxgeo_first_events, jaxgeo::first_events,
                              jaxgeo::events_bound().Attr<int64_t>("constants").Attr<int64_t>("lines"));

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxgeo_first_hits, jaxgeo::first_hits,
                              jaxgeo::events_bound()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::PRED>>()
                                  .Attr<int64_t>("constants")
                                  .Attr<int64_t>("lines"));
#pragma GCC visibility pop
