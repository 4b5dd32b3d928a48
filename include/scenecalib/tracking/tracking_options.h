#pragma once

#include "scenecalib/base/options.h"

namespace scenecalib {

/// How much of the past a tracker keeps.
struct ImageBufferOptions {
  int max_images = 600;
  void Visit(OptionVisitor& v) {
    v.Field("max_images", &max_images, {10, 100000},
            "images kept per camera; beyond it the oldest are forgotten with their observations");
  }
};

/// Everything that steers feature tracking.
struct TrackingOptions {
  ImageBufferOptions buffer;
  void Visit(OptionVisitor& v) { v.Group("buffer", &buffer); }
};

}  // namespace scenecalib
