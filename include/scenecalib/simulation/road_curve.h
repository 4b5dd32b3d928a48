#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "scenecalib/base/random.h"

namespace scenecalib {

/// The road's centreline in the map (x, y), by arc length, and its surface's height. s runs along
/// the road, d to the left of it. Curvature is a smooth function of s (no jump in the steering
/// angle). Corners alternate left and right, so a road never meets itself.
class RoadCurve {
 public:
  /// Covers [start_s_m, end_s_m]; curves lie within [0, drive_length_m] only, s = 0 is the origin.
  /// `drive_kind` as in SimulatedDriveOptions, known to be valid. `corner_radius_m` bounds how
  /// sharp a corner is.
  RoadCurve(const std::string& drive_kind, double start_s_m, double drive_length_m, double end_s_m,
            double corner_radius_m, Random random);

  double start_s_m() const { return start_s_m_; }
  double end_s_m() const { return end_s_m_; }

  double Heading(double s) const;    ///< radians, unwrapped
  double Curvature(double s) const;  ///< 1/m, positive to the left
  /// Height of the gentle hills, to be followed by everything.
  double HillHeight(double s) const;
  /// Height of the road's uneven surface: hills, crown, bumps of a few centimetres.
  double RoadHeight(double s, double d) const;
  /// Bumps only, to be added to any ground.
  double BumpHeight(double s, double d) const;
  /// A point `height_m` above the hills.
  Eigen::Vector3d Point(double s, double d, double height_m) const;
  /// Unit vector along the road, horizontal.
  Eigen::Vector3d Along(double s) const;
  /// Unit vector to the left of the road, horizontal.
  Eigen::Vector3d Left(double s) const;

 private:
  struct Bend {
    double middle_s_m;
    double half_length_m;
    double angle_rad;
  };
  struct Wave {
    double amplitude_m, wavelength_m, phase_rad;
  };
  double start_s_m_;
  double end_s_m_;
  std::vector<Bend> bends_;
  std::vector<Wave> hills_;
  std::vector<Eigen::Vector2d> points_;  ///< every kStep metres from start_s_m_
  std::uint32_t bump_seed_;
};

}  // namespace scenecalib
