#pragma once

#include <cstddef>

#include "scenecalib/base/options.h"
#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/evaluation/miscalibration_rate.h"
#include "scenecalib/mapping/mapping_options.h"
#include "scenecalib/pipeline/fitness.h"
#include "scenecalib/segment/segment_chooser.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// Which streams of measurements are refused as a whole.
struct StreamCheckOptions {
  double max_stamp_gap_s = 2.0;
  double max_backwards_share = 0.05;

  void Visit(OptionVisitor& v) {
    v.Field("max_stamp_gap_s", &max_stamp_gap_s, {0.1, 1000.0},
            "a longer jump between two scans leaves the motion between them unknown: refused");
    v.Field("max_backwards_share", &max_backwards_share, {0.0, 1.0},
            "share of a sensor's messages whose stamp does not increase; more are refused, fewer "
            "are skipped");
  }
};

/// Every stage's options in one: the keys of the configuration file.
struct PipelineOptions {
  /// A calibration takes joint.max_tracks_per_camera tracks: some more are measured, so that
  /// verification and the held-out part leave enough.
  static constexpr int kMaxTracks = 4500;

  PipelineOptions() {
    tracking.registration.max_tracks = kMaxTracks;
    // Of these it takes the long ones: more features of wide cameras cost time and gain nothing.
    tracking.detection.max_wide_factor = 1.0;
  }

  int threads = 0;
  StreamCheckOptions stream_check;
  SegmentChoiceOptions segment;
  FitnessOptions fitness;
  MappingOptions mapping;
  TrackingOptions tracking;
  CalibrationOptions calibration;
  MiscalibrationOptions miscalibration;

  void Visit(OptionVisitor& v) {
    v.Field("threads", &threads, {0, 1024}, "processor cores to use, 0 for all; no result changes");
    v.Group("stream_check", &stream_check);
    v.Group("segment", &segment);
    v.Group("fitness", &fitness);
    v.Group("mapping", &mapping);
    v.Group("tracking", &tracking);
    v.Group("calibration", &calibration);
    v.Group("miscalibration", &miscalibration);
  }
};

/// Processor cores that PipelineOptions::threads stands for, at least one.
std::size_t NumThreads(int threads_option);

}  // namespace scenecalib
