#include "patch_sampling.h"

#include <algorithm>

#include "pixel_kernels.h"
#include "vector_dispatch.h"

#ifdef SCENECALIB_HAS_AVX2_CODE
#include <immintrin.h>
#endif

namespace scenecalib {
namespace {

const SplineTable kSpline;

/// A warp in single precision.
struct Warp {
  explicit Warp(const PatchWarp& warp)
      : center(warp.center_px.cast<float>()),
        affine(warp.affine.cast<float>()),
        quadratic(warp.quadratic.cast<float>()) {}

  Eigen::Vector2f center;
  Eigen::Matrix2f affine;
  Eigen::Matrix<float, 2, 3> quadratic;
};

/// Calls body(cell_at) for every row: cell_at(x) locates the row's pixel at x.
template <typename Body>
void ForEachRow(const cv::Mat& image, const PatchPixels& pixels, const Body& body) {
  const Warp warp(pixels.warp);
  const Eigen::Matrix2f& a = warp.affine;
  const Eigen::Matrix<float, 2, 3>& q = warp.quadratic;
  for (int y = -pixels.radius_px; y <= pixels.radius_px; y += pixels.stride) {
    const auto fy = static_cast<float>(y);
    const float row_x = warp.center.x() + (a(0, 1) + q(0, 2) * fy) * fy;
    const float row_y = warp.center.y() + (a(1, 1) + q(1, 2) * fy) * fy;
    const float slope_x = a(0, 0) + q(0, 1) * fy;
    const float slope_y = a(1, 0) + q(1, 1) * fy;
    body([&](int x) {
      const auto fx = static_cast<float>(x);
      return Locate(image, row_x + (slope_x + q(0, 0) * fx) * fx,
                    row_y + (slope_y + q(1, 0) * fx) * fx);
    });
  }
}

void SampleSmooth(const cv::Mat& image, const PatchPixels& pixels, float* value) {
  const std::size_t step = image.step[0];
  const cv::v_float32x4 unit = cv::v_setall_f32(1.0F / SplineTable::kOne);
  const int radius = pixels.radius_px;
  const int stride = pixels.stride;
  ForEachRow(image, pixels, [&](const auto& cell_at) {
    const auto columns_at = [&](int at) {
      const Cell cell = cell_at(at);
      return WeighColumns(cell.corner, step, kSpline.At(cell.fraction_x),
                          kSpline.At(cell.fraction_y));
    };
    int x = -radius;
    for (; x + 3 * stride <= radius; x += 4 * stride, value += 4) {
      cv::v_store(value, cv::v_reduce_sum4(columns_at(x), columns_at(x + stride),
                                           columns_at(x + 2 * stride), columns_at(x + 3 * stride)) *
                             unit);
    }
    for (; x <= radius; x += stride) *value++ = cv::v_reduce_sum(columns_at(x) * unit);
  });
}

void SampleBilinear(const cv::Mat& image, const PatchPixels& pixels, float* value) {
  const std::size_t step = image.step[0];
  ForEachRow(image, pixels, [&](const auto& cell_at) {
    for (int x = -pixels.radius_px; x <= pixels.radius_px; x += pixels.stride) {
      *value++ = Bilinear(cell_at(x), step);
    }
  });
}

#ifdef SCENECALIB_HAS_AVX2_CODE

// Lanes 0 to 3 are neighbours in one row of the patch, 4 to 7 those below them: a quad each.
constexpr int kQuad = 4;
/// Quads of a row that are located before the first of them is read: the processor need not wait.
constexpr int kAtOnce = 8;
/// A quad is compact when its pixels lie within that many columns and two rows: then they are read
/// in loads of 16 bytes.
constexpr int kMaxCompactSpan = 12;

/// Where eight pixels lie in the image.
struct Lanes {
  __m256 fraction_x;
  __m256 fraction_y;
  /// Of the pixel above and to the left, from the image's first.
  alignas(32) int offset[2 * kQuad];
  /// Of a compact quad's upper left one; all four alike.
  alignas(32) int quad_offset[2 * kQuad];
  __m256i bytes;  ///< four for each lane, counted from there
  __m256i lower;  ///< whether a lane's first row is the quad's second
};

SCENECALIB_AVX2 inline __m256 Halves(float first, float second) {
  return _mm256_set_m128(_mm_set1_ps(second), _mm_set1_ps(first));
}

/// The warp along two rows of a patch: places are constant + (slope + bend x) x.
struct RowPair {
  __m256 constant[2];
  __m256 slope[2];
  __m256 bend[2];
};

SCENECALIB_AVX2 inline RowPair AlongRows(const Warp& warp, float first_y, float second_y) {
  const __m256 y = Halves(first_y, second_y);
  RowPair rows;
  for (int k = 0; k < 2; ++k) {
    const Eigen::Matrix<float, 2, 3>& q = warp.quadratic;
    const __m256 by_y =
        _mm256_fmadd_ps(_mm256_set1_ps(q(k, 2)), y, _mm256_set1_ps(warp.affine(k, 1)));
    rows.constant[k] = _mm256_fmadd_ps(by_y, y, _mm256_set1_ps(warp.center[k]));
    rows.slope[k] = _mm256_fmadd_ps(_mm256_set1_ps(q(k, 1)), y, _mm256_set1_ps(warp.affine(k, 0)));
    rows.bend[k] = _mm256_set1_ps(q(k, 0));
  }
  return rows;
}

/// Returns zero where a quad is compact and its loads end inside the image.
SCENECALIB_AVX2 inline __m256i LocateLanes(const RowPair& rows, __m256 x, const cv::Mat& image,
                                           Lanes* lanes) {
  __m256 at[2];
  for (int k = 0; k < 2; ++k) {
    at[k] = _mm256_fmadd_ps(_mm256_fmadd_ps(rows.bend[k], x, rows.slope[k]), x, rows.constant[k]);
  }
  const __m256i column = _mm256_cvttps_epi32(at[0]);
  const __m256i row = _mm256_cvttps_epi32(at[1]);
  lanes->fraction_x = _mm256_sub_ps(at[0], _mm256_cvtepi32_ps(column));
  lanes->fraction_y = _mm256_sub_ps(at[1], _mm256_cvtepi32_ps(row));
  const __m256i step = _mm256_set1_epi32(static_cast<int>(image.step[0]));
  const __m256i offset = _mm256_add_epi32(_mm256_mullo_epi32(row, step), column);
  _mm256_store_si256(reinterpret_cast<__m256i*>(lanes->offset), offset);

  constexpr int kFirst = 0x00;  // of four lanes
  constexpr int kLast = 0xFF;
  const __m256i left = _mm256_shuffle_epi32(column, kFirst);
  const __m256i top =
      _mm256_min_epi32(_mm256_shuffle_epi32(row, kFirst), _mm256_shuffle_epi32(row, kLast));
  _mm256_store_si256(reinterpret_cast<__m256i*>(lanes->quad_offset),
                     _mm256_add_epi32(_mm256_mullo_epi32(top, step), left));
  const __m256i across = _mm256_sub_epi32(column, left);
  const __m256i down = _mm256_sub_epi32(row, top);
  const __m256i first_byte_of_each =
      _mm256_setr_epi8(0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8, 8, 12, 12, 12, 12, 0, 0, 0, 0, 4, 4, 4, 4,
                       8, 8, 8, 8, 12, 12, 12, 12);
  lanes->bytes = _mm256_add_epi8(_mm256_shuffle_epi8(across, first_byte_of_each),
                                 _mm256_set1_epi32(0x03020100));
  lanes->lower = _mm256_cmpgt_epi32(down, _mm256_setzero_si256());
  const __m256i too_wide =
      _mm256_or_si256(_mm256_cmpgt_epi32(across, _mm256_set1_epi32(kMaxCompactSpan)),
                      _mm256_cmpgt_epi32(_mm256_setzero_si256(), across));
  const __m256i too_high = _mm256_andnot_si256(_mm256_set1_epi32(1), down);
  // Loads begin one pixel to the left and one row above, and five rows are read.
  const __m256i at_border =
      _mm256_or_si256(_mm256_cmpgt_epi32(left, _mm256_set1_epi32(image.cols - 15)),
                      _mm256_cmpgt_epi32(top, _mm256_set1_epi32(image.rows - 4)));
  return _mm256_or_si256(_mm256_or_si256(too_wide, too_high), at_border);
}

SCENECALIB_AVX2 inline __m256i BytesOf(const uchar* origin, const Lanes& lanes) {
  const auto load = [origin](int offset) {
    return reinterpret_cast<const __m128i*>(origin + offset);
  };
  const __m128i first = _mm_loadu_si128(load(lanes.quad_offset[0]));
  const __m128i second = _mm_loadu_si128(load(lanes.quad_offset[kQuad]));
  return _mm256_shuffle_epi8(_mm256_inserti128_si256(_mm256_castsi128_si256(first), second, 1),
                             lanes.bytes);
}

/// Four neighbouring pixels of kRows rows for each lane, the first at `origin` and the lane's
/// offset.
template <int kRows>
SCENECALIB_AVX2 inline void ReadCompact(const uchar* origin, int step, const Lanes& lanes,
                                        __m256i* rows) {
  __m256i upper = BytesOf(origin, lanes);
  for (int k = 0; k < kRows; ++k) {
    const __m256i next = BytesOf(origin + (k + 1) * step, lanes);
    rows[k] = _mm256_blendv_epi8(upper, next, lanes.lower);
    upper = next;
  }
}

/// The same for any lanes. Single loads: gathering is slower on many processors.
template <int kRows>
SCENECALIB_AVX2 inline void ReadScattered(const uchar* origin, int step, const Lanes& lanes,
                                          __m256i* rows) {
  for (int k = 0; k < kRows; ++k) {
    const auto four = [&](int lane) {
      return static_cast<int>(FourPixels(origin + k * step + lanes.offset[lane]));
    };
    rows[k] =
        _mm256_setr_epi32(four(0), four(1), four(2), four(3), four(4), four(5), four(6), four(7));
  }
}

/// Weights of a row's four pixels, 16-bit integers: of the first and third, of the other two.
struct AcrossWeights {
  __m256i even;
  __m256i odd;
};

SCENECALIB_AVX2 inline __m256i ToWhole(__m256 weights) {
  return _mm256_cvtps_epi32(_mm256_mul_ps(weights, _mm256_set1_ps(SplineTable::kOne)));
}

/// The second pixel's weight is what the others leave of one.
SCENECALIB_AVX2 inline AcrossWeights ToPairs(__m256i first, __m256i third, __m256i fourth) {
  const __m256i others = _mm256_add_epi32(_mm256_add_epi32(first, third), fourth);
  const __m256i second = _mm256_sub_epi32(_mm256_set1_epi32(SplineTable::kOne), others);
  return {_mm256_or_si256(first, _mm256_slli_epi32(third, 16)),
          _mm256_or_si256(second, _mm256_slli_epi32(fourth, 16))};
}

/// Times SplineTable::kOne.
SCENECALIB_AVX2 inline __m256 Weigh(__m256i four, const AcrossWeights& weights) {
  const __m256i even = _mm256_and_si256(four, _mm256_set1_epi32(0x00FF00FF));
  const __m256i odd = _mm256_srli_epi16(four, 8);
  return _mm256_cvtepi32_ps(
      _mm256_add_epi32(_mm256_madd_epi16(even, weights.even), _mm256_madd_epi16(odd, weights.odd)));
}

SCENECALIB_AVX2 inline void SplineWeightsOf(__m256 t, __m256* weights) {
  const __m256 one = _mm256_set1_ps(1.0F);
  const __m256 half = _mm256_set1_ps(0.5F);
  const __m256 sixth = _mm256_set1_ps(1.0F / 6.0F);
  const __m256 two_thirds = _mm256_set1_ps(2.0F / 3.0F);
  const __m256 u = _mm256_sub_ps(one, t);
  const __m256 t2 = _mm256_mul_ps(t, t);
  const __m256 u2 = _mm256_mul_ps(u, u);
  weights[0] = _mm256_mul_ps(_mm256_mul_ps(u2, u), sixth);
  weights[1] = _mm256_fmadd_ps(t2, _mm256_fmsub_ps(half, t, one), two_thirds);
  weights[2] = _mm256_fmadd_ps(u2, _mm256_fmsub_ps(half, u, one), two_thirds);
  weights[3] = _mm256_mul_ps(_mm256_mul_ps(t2, t), sixth);
}

struct SmoothReading {
  static constexpr PatchReading kReading = PatchReading::kSmooth;
  static constexpr int kRows = 4;
  static constexpr int kFirstRow = -1;

  SCENECALIB_AVX2 static __m256 Value(const __m256i* rows, const Lanes& lanes) {
    __m256 across[4], down[4];
    SplineWeightsOf(lanes.fraction_x, across);
    SplineWeightsOf(lanes.fraction_y, down);
    const AcrossWeights weights =
        ToPairs(ToWhole(across[0]), ToWhole(across[2]), ToWhole(across[3]));
    __m256 sum = _mm256_mul_ps(down[0], Weigh(rows[0], weights));
    for (int k = 1; k < 4; ++k) sum = _mm256_fmadd_ps(down[k], Weigh(rows[k], weights), sum);
    return sum;
  }
};

/// Between the second and the third pixel of its rows.
struct BilinearReading {
  static constexpr PatchReading kReading = PatchReading::kBilinear;
  static constexpr int kRows = 2;
  static constexpr int kFirstRow = 0;

  SCENECALIB_AVX2 static __m256 Value(const __m256i* rows, const Lanes& lanes) {
    const __m256i none = _mm256_setzero_si256();
    const AcrossWeights weights = ToPairs(none, ToWhole(lanes.fraction_x), none);
    const __m256 top = Weigh(rows[0], weights);
    const __m256 bottom = Weigh(rows[1], weights);
    return _mm256_fmadd_ps(lanes.fraction_y, _mm256_sub_ps(bottom, top), top);
  }
};

/// Eight pixels at a time. Where a row ends between quads its last ones are read twice.
template <typename Reading>
SCENECALIB_AVX2 void SampleAvx2(const cv::Mat& image, const PatchPixels& pixels, float* values) {
  const Warp warp(pixels.warp);
  const int edge = 2 * pixels.radius_px / pixels.stride + 1;
  if (edge < kQuad) {
    PortableSampler(Reading::kReading)(image, pixels, values);
    return;
  }
  const auto step = static_cast<int>(image.step[0]);
  const uchar* origin = image.data + Reading::kFirstRow * step - 1;
  const __m256 unit = _mm256_set1_ps(1.0F / SplineTable::kOne);
  const __m256 stride = _mm256_set1_ps(static_cast<float>(pixels.stride));
  const __m256 radius = _mm256_set1_ps(static_cast<float>(pixels.radius_px));
  const __m256 in_quad = _mm256_setr_ps(0.0F, 1.0F, 2.0F, 3.0F, 0.0F, 1.0F, 2.0F, 3.0F);
  const int num_quads = (edge + kQuad - 1) / kQuad;
  Lanes lanes[kAtOnce];
  for (int row = 0; row < edge; row += 2) {
    const int below = std::min(row + 1, edge - 1);
    const RowPair rows = AlongRows(warp, static_cast<float>(row * pixels.stride - pixels.radius_px),
                                   static_cast<float>(below * pixels.stride - pixels.radius_px));
    for (int first = 0; first < num_quads; first += kAtOnce) {
      const int count = std::min(kAtOnce, num_quads - first);
      const auto column_of = [&](int i) { return std::min((first + i) * kQuad, edge - kQuad); };
      __m256i scattered = _mm256_setzero_si256();
      for (int i = 0; i < count; ++i) {
        const __m256 column =
            _mm256_add_ps(in_quad, _mm256_set1_ps(static_cast<float>(column_of(i))));
        scattered = _mm256_or_si256(
            scattered,
            LocateLanes(rows, _mm256_fmsub_ps(column, stride, radius), image, &lanes[i]));
      }
      const bool compact = _mm256_testz_si256(scattered, scattered) != 0;
      for (int i = 0; i < count; ++i) {
        __m256i four[Reading::kRows];
        if (compact) {
          ReadCompact<Reading::kRows>(origin, step, lanes[i], four);
        } else {
          ReadScattered<Reading::kRows>(origin, step, lanes[i], four);
        }
        const __m256 value = _mm256_mul_ps(unit, Reading::Value(four, lanes[i]));
        float* target = values + column_of(i);
        _mm_storeu_ps(target + row * edge, _mm256_castps256_ps128(value));
        _mm_storeu_ps(target + below * edge, _mm256_extractf128_ps(value, 1));
      }
    }
  }
}

SCENECALIB_AVX2 void SampleSmoothAvx2(const cv::Mat& image, const PatchPixels& pixels,
                                      float* values) {
  SampleAvx2<SmoothReading>(image, pixels, values);
}

SCENECALIB_AVX2 void SampleBilinearAvx2(const cv::Mat& image, const PatchPixels& pixels,
                                        float* values) {
  SampleAvx2<BilinearReading>(image, pixels, values);
}

#endif  // SCENECALIB_HAS_AVX2_CODE

}  // namespace

PatchSampler PortableSampler(PatchReading reading) {
  return reading == PatchReading::kSmooth ? SampleSmooth : SampleBilinear;
}

PatchSampler VectorSampler(PatchReading reading) {
#ifdef SCENECALIB_HAS_AVX2_CODE
  if (HasAvx2()) {
    return reading == PatchReading::kSmooth ? SampleSmoothAvx2 : SampleBilinearAvx2;
  }
#endif
  static_cast<void>(reading);
  return nullptr;
}

PatchSampler FastestSampler(PatchReading reading) {
  const PatchSampler vector = VectorSampler(reading);
  return vector != nullptr ? vector : PortableSampler(reading);
}

}  // namespace scenecalib
