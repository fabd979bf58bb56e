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

// The buffers of a call, one after the other.
class Buffers {
 public:
  explicit Buffers(ffi::RemainingArgs args) : args_(args) {}

  ffi::AnyBuffer next() {
    auto buffer = args_.get<ffi::AnyBuffer>(number_++);
    if (buffer.has_error()) {
      is_sound_ = false;
      static XLA_FFI_Buffer nothing{};
      return ffi::AnyBuffer(&nothing);
    }
    return *buffer;
  }

  template <class T>
  const T* data() {
    return static_cast<const T*>(next().untyped_data());
  }

  // One number per ray, or one for all.
  Numbers numbers() {
    const auto buffer = next();
    return {static_cast<const double*>(buffer.untyped_data()), buffer.dimensions().size() > 0 ? 1 : 0};
  }

  LineField line() {
    const auto values = next(), first = next(), step = next();
    const auto stride = [](const ffi::AnyBuffer& x) {
      return x.dimensions().size() > 1 ? static_cast<int64_t>(x.dimensions()[1]) : 0;
    };
    const auto of = [](const ffi::AnyBuffer& x) { return static_cast<const double*>(x.untyped_data()); };
    return {of(values), of(first), of(step), values.dimensions().back(), stride(values), stride(first), stride(step)};
  }

  bool is_sound() const { return is_sound_; }

 private:
  ffi::RemainingArgs args_;
  size_t number_ = 0;
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

// Texels before each level of a pyramid over the cells of an array of posts.
void levels_of(Terrain& terrain) {
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
}

// A terrain, and what holds the parts of its field.
struct Ground {
  Terrain terrain{};
  std::vector<Numbers> constants;
  std::vector<LineField> lines;
};

ffi::Error read_ground(Buffers& buffers, int64_t constants, int64_t lines, Ground& ground) {
  Terrain& terrain = ground.terrain;
  const auto posts = buffers.next();
  if (!buffers.is_sound() || posts.dimensions().size() != 2 || !kind_of(posts.element_type(), &terrain.kind))
    return ffi::Error::InvalidArgument("the posts of a native search must be an array of heights (rows, cols)");
  terrain.posts = posts.untyped_data();
  terrain.rows = static_cast<int32_t>(posts.dimensions()[0]);
  terrain.cols = static_cast<int32_t>(posts.dimensions()[1]);
  terrain.voids = buffers.data<bool>();
  terrain.has_void = *buffers.data<bool>();
  const int32_t* extent = buffers.data<int32_t>();
  terrain.true_rows = extent[0];
  terrain.true_cols = extent[1];
  terrain.bounds = buffers.data<uint16_t>();
  terrain.base = *buffers.data<double>();
  terrain.step = *buffers.data<double>();
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
  levels_of(terrain);
  return ffi::Error::Success();
}

Tracks read_tracks(Buffers& buffers) {
  Tracks tracks;
  for (auto& coefficients : tracks.coefficients) coefficients = buffers.data<double>();
  tracks.here = buffers.data<int32_t>();
  tracks.news = buffers.data<int32_t>();
  return tracks;
}

GeographicGrid read_grid(Buffers& buffers) {
  const double *rowcol0 = buffers.data<double>(), *lonlat0 = buffers.data<double>(), *step = buffers.data<double>();
  const double* cell_size = buffers.data<double>();
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

const char* const TOO_FEW = "a native search was called with too few arrays";
using Doubles = ffi::Result<ffi::Buffer<ffi::F64>>;
using Integers = ffi::Result<ffi::Buffer<ffi::S32>>;
using Flags = ffi::Result<ffi::Buffer<ffi::PRED>>;

ffi::Error first_events(ffi::ThreadPool pool, ffi::RemainingArgs args, Integers news, Doubles begin, Doubles root,
                        Doubles below, Integers row, Integers col, int64_t constants, int64_t lines) {
  Buffers buffers(args);
  const Tracks tracks = read_tracks(buffers);
  Ground ground;
  const ffi::Error error = read_ground(buffers, constants, lines, ground);
  if (error.failure()) return error;
  if (!buffers.is_sound()) return ffi::Error::InvalidArgument(TOO_FEW);
  const Events events = {news->typed_data(),
                         {begin->typed_data(), root->typed_data(), below->typed_data()},
                         {row->typed_data(), col->typed_data()}};
  const Terrain terrain = ground.terrain;
  by_chunks(pool, static_cast<int64_t>(news->element_count()),
            [=](int64_t first, int64_t last) { kernels().walk(terrain, tracks, events, first, last); });
  return ffi::Error::Success();
}

ffi::Error first_hits(ffi::ThreadPool pool, ffi::RemainingArgs args, Integers news, Doubles begin, Doubles root,
                      Doubles below, Integers row, Integers col, Integers track_count, Flags is_above,
                      int64_t constants, int64_t lines) {
  Buffers buffers(args);
  Rays rays{};
  for (const double** numbers : {&rays.origins, &rays.directions, &rays.passed, &rays.lengths, &rays.ends,
                                 &rays.firsts, &rays.lasts})
    *numbers = buffers.data<double>();
  rays.grid = read_grid(buffers);
  const Tracks tracks = read_tracks(buffers);
  Ground ground;
  const ffi::Error error = read_ground(buffers, constants, lines, ground);
  if (error.failure()) return error;
  if (!buffers.is_sound()) return ffi::Error::InvalidArgument(TOO_FEW);
  const Hits hits = {news->typed_data(),
                     {begin->typed_data(), root->typed_data(), below->typed_data()},
                     {row->typed_data(), col->typed_data()},
                     track_count->typed_data(),
                     is_above->typed_data()};
  const Terrain terrain = ground.terrain;
  by_chunks(pool, static_cast<int64_t>(news->element_count()),
            [=](int64_t first, int64_t last) { kernels().follow(terrain, rays, tracks, hits, first, last); });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxgeo

#pragma GCC visibility push(default)
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxgeo_first_events, jaxgeo::first_events,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .RemainingArgs()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Attr<int64_t>("constants")
                                  .Attr<int64_t>("lines"));

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxgeo_first_hits, jaxgeo::first_hits,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .RemainingArgs()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::S32>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::PRED>>()
                                  .Attr<int64_t>("constants")
                                  .Attr<int64_t>("lines"));
#pragma GCC visibility pop
