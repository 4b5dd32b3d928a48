#pragma once

#include <Eigen/Core>

#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// Turns the covariances of matches against a track's reference view into covariances of the single
/// observations. The residual of a match holds the noise of both images, so each image has half of
/// its covariance; the reference's half is common to all matches, that is, the reference's own.
/// `mean_in_reference_px2` is the mean of the matches' covariances, brought to the reference view;
/// `sigma_floor_px` is added to all.
inline void ShareMatchCovariance(const Eigen::Matrix2d& mean_in_reference_px2,
                                 double sigma_floor_px, Track* track) {
  track->observations[track->reference].covariance_px2 = mean_in_reference_px2;
  for (TrackObservation& observation : track->observations) {
    observation.covariance_px2 = 0.5 * observation.covariance_px2 +
                                 sigma_floor_px * sigma_floor_px * Eigen::Matrix2d::Identity();
  }
}

}  // namespace scenecalib
