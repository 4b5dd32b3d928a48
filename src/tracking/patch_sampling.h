#pragma once

#include <opencv2/core.hpp>

#include "scenecalib/tracking/patch_registration.h"

namespace scenecalib {

/// The pixels of a patch that are to be read in another image: every `stride`-th of every
/// `stride`-th row, from the first one on.
struct PatchPixels {
  PatchWarp warp;
  int radius_px = 0;
  int stride = 1;
};

/// Writes the grey values, row by row. The four by four pixels around each must lie inside the
/// image.
using PatchSampler = void (*)(const cv::Mat& image, const PatchPixels& pixels, float* values);

/// For any processor.
PatchSampler PortableSampler(PatchReading reading);
/// Eight pixels at a time, with AVX2 and FMA; null where the processor has neither. Its values
/// differ from the portable ones by rounding.
PatchSampler VectorSampler(PatchReading reading);
/// The fastest that this processor has.
PatchSampler FastestSampler(PatchReading reading);

}  // namespace scenecalib
