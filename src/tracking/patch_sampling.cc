#include "patch_sampling.h"

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

constexpr int kLanes = 8;

/// Where eight pixels lie in the image: whole pixels and fractions.
struct Lanes {
  alignas(32) int offset[kLanes];  ///< of the pixel above and to the left, from the image's first
  __m256 fraction_x;
  __m256 fraction_y;
};

/// Of the patch's pixels first..first+7, row by row; those behind the last are the last.
SCENECALIB_AVX2 inline Lanes LocateLanes(const Warp& warp, const PatchPixels& pixels, int edge,
                                         int first, int step) {
  const __m256 number =
      _mm256_min_ps(_mm256_add_ps(_mm256_set1_ps(static_cast<float>(first)),
                                  _mm256_setr_ps(0.0F, 1.0F, 2.0F, 3.0F, 4.0F, 5.0F, 6.0F, 7.0F)),
                    _mm256_set1_ps(static_cast<float>(edge * edge - 1)));
  // Half a pixel more, so that rounding never ends in the row before.
  const __m256 row =
      _mm256_floor_ps(_mm256_mul_ps(_mm256_add_ps(number, _mm256_set1_ps(0.5F)),
                                    _mm256_set1_ps(1.0F / static_cast<float>(edge))));
  const __m256 column = _mm256_fnmadd_ps(row, _mm256_set1_ps(static_cast<float>(edge)), number);
  const __m256 stride = _mm256_set1_ps(static_cast<float>(pixels.stride));
  const __m256 radius = _mm256_set1_ps(static_cast<float>(pixels.radius_px));
  const __m256 x = _mm256_fmsub_ps(column, stride, radius);
  const __m256 y = _mm256_fmsub_ps(row, stride, radius);
  __m256 at[2];
  for (int k = 0; k < 2; ++k) {
    const Eigen::Matrix<float, 2, 3>& q = warp.quadratic;
    const __m256 by_x = _mm256_fmadd_ps(
        _mm256_set1_ps(q(k, 0)), x,
        _mm256_fmadd_ps(_mm256_set1_ps(q(k, 1)), y, _mm256_set1_ps(warp.affine(k, 0))));
    const __m256 by_y =
        _mm256_fmadd_ps(_mm256_set1_ps(q(k, 2)), y, _mm256_set1_ps(warp.affine(k, 1)));
    at[k] = _mm256_fmadd_ps(by_x, x, _mm256_fmadd_ps(by_y, y, _mm256_set1_ps(warp.center[k])));
  }
  const __m256i whole_x = _mm256_cvttps_epi32(at[0]);
  const __m256i whole_y = _mm256_cvttps_epi32(at[1]);
  Lanes lanes;
  lanes.fraction_x = _mm256_sub_ps(at[0], _mm256_cvtepi32_ps(whole_x));
  lanes.fraction_y = _mm256_sub_ps(at[1], _mm256_cvtepi32_ps(whole_y));
  const __m256i offset =
      _mm256_add_epi32(_mm256_mullo_epi32(whole_y, _mm256_set1_epi32(step)), whole_x);
  _mm256_store_si256(reinterpret_cast<__m256i*>(lanes.offset), offset);
  return lanes;
}

/// Four neighbouring pixels of a row for each lane. Single loads: gathering is slower on many
/// processors.
SCENECALIB_AVX2 inline __m256i FourPixelsOf(const uchar* origin, const int* offset) {
  const auto four = [&](int lane) { return static_cast<int>(FourPixels(origin + offset[lane])); };
  return _mm256_setr_epi32(four(0), four(1), four(2), four(3), four(4), four(5), four(6), four(7));
}

template <int kPixel>
SCENECALIB_AVX2 inline __m256 PixelOf(__m256i four) {
  const __m256i shifted = _mm256_srli_epi32(four, 8 * kPixel);
  return _mm256_cvtepi32_ps(_mm256_and_si256(shifted, _mm256_set1_epi32(255)));
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

SCENECALIB_AVX2 inline void Store(__m256 lanes, int count, float* values) {
  if (count >= kLanes) {
    _mm256_storeu_ps(values, lanes);
    return;
  }
  alignas(32) float all[kLanes];
  _mm256_store_ps(all, lanes);
  for (int i = 0; i < count; ++i) values[i] = all[i];
}

int EdgeOf(const PatchPixels& pixels) { return 2 * pixels.radius_px / pixels.stride + 1; }

SCENECALIB_AVX2 void SampleSmoothAvx2(const cv::Mat& image, const PatchPixels& pixels,
                                      float* values) {
  const Warp warp(pixels.warp);
  const int edge = EdgeOf(pixels);
  const auto step = static_cast<int>(image.step[0]);
  for (int i = 0; i < edge * edge; i += kLanes) {
    const Lanes lanes = LocateLanes(warp, pixels, edge, i, step);
    __m256 across[4], down[4];
    SplineWeightsOf(lanes.fraction_x, across);
    SplineWeightsOf(lanes.fraction_y, down);
    __m256 sum = _mm256_setzero_ps();
    for (int k = 0; k < 4; ++k) {
      const __m256i four = FourPixelsOf(image.data + (k - 1) * step - 1, lanes.offset);
      __m256 row = _mm256_mul_ps(across[0], PixelOf<0>(four));
      row = _mm256_fmadd_ps(across[1], PixelOf<1>(four), row);
      row = _mm256_fmadd_ps(across[2], PixelOf<2>(four), row);
      row = _mm256_fmadd_ps(across[3], PixelOf<3>(four), row);
      sum = _mm256_fmadd_ps(down[k], row, sum);
    }
    Store(sum, edge * edge - i, values + i);
  }
}

SCENECALIB_AVX2 void SampleBilinearAvx2(const cv::Mat& image, const PatchPixels& pixels,
                                        float* values) {
  const Warp warp(pixels.warp);
  const int edge = EdgeOf(pixels);
  const auto step = static_cast<int>(image.step[0]);
  for (int i = 0; i < edge * edge; i += kLanes) {
    const Lanes lanes = LocateLanes(warp, pixels, edge, i, step);
    // One pixel further left than needed: what is read must end inside the image.
    const __m256i above = FourPixelsOf(image.data - 1, lanes.offset);
    const __m256i below = FourPixelsOf(image.data + step - 1, lanes.offset);
    const __m256 left = PixelOf<1>(above);
    const __m256 top =
        _mm256_fmadd_ps(lanes.fraction_x, _mm256_sub_ps(PixelOf<2>(above), left), left);
    const __m256 left_below = PixelOf<1>(below);
    const __m256 bottom =
        _mm256_fmadd_ps(lanes.fraction_x, _mm256_sub_ps(PixelOf<2>(below), left_below), left_below);
    Store(_mm256_fmadd_ps(lanes.fraction_y, _mm256_sub_ps(bottom, top), top), edge * edge - i,
          values + i);
  }
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
