#pragma once

#include <cstdint>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {

/// RANSAC over tracks (III-D).
struct TrackRansacOptions {
  int num_hypotheses = 48;
  int sample_tracks = 12;
  int max_scored_tracks = 500;
  double inlier_sigmas = 3.0;
  void Visit(OptionVisitor& v) {
    v.Field("num_hypotheses", &num_hypotheses, {0, 100000}, "random samples tried in each round");
    v.Field("sample_tracks", &sample_tracks, {3, 1000}, "tracks in a sample");
    v.Field("max_scored_tracks", &max_scored_tracks, {10, 1000000},
            "tracks on which a sample's pose is scored");
    v.Field("inlier_sigmas", &inlier_sigmas, {1.0, 100.0},
            "a track is an inlier when its RMSE is below so many robust sigmas");
  }
};

/// A camera's pose and the tracks that agree with it.
struct TrackRansacResult {
  CameraParameters camera;
  std::vector<bool> is_inlier;  ///< parallel to EvaluateTracks(terms)
  int num_inliers = 0;
  double threshold_whitened = 0.0;
  bool from_sample = false;  ///< true when a random sample beat the pose it started from
};

/// Finds the pose of one camera (rotation, and translation when free) that most tracks agree with,
/// by the RMSE of Eq. (2) per track. The pose in `cameras` competes as the first hypothesis.
/// Deterministic in `seed`, whatever the number of threads.
TrackRansacResult RansacTracks(const CalibrationProblem& problem, int camera,
                               const TrackRansacOptions& options, std::uint64_t seed);

}  // namespace scenecalib
