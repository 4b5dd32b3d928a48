#include "scenecalib/mapping/motion_prior.h"

#include <algorithm>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

/// Longest hole between samples that is still bridged; a 10 Hz IMU must pass.
constexpr double kMaxGapS = 0.25;
/// How far the nearest sample may lie beyond an end of the interval: live, the sweep's last IMU
/// samples often arrive after the sweep.
constexpr double kMaxOverhangS = 0.11;

template <typename Sample>
bool InsertSorted(const Sample& sample, std::deque<Sample>* samples) {
  auto after = samples->end();
  while (after != samples->begin() && std::prev(after)->stamp_ns > sample.stamp_ns) --after;
  if (after != samples->begin() && std::prev(after)->stamp_ns == sample.stamp_ns) return false;
  samples->insert(after, sample);
  return true;
}

template <typename Sample>
auto FirstAtOrAfter(const std::deque<Sample>& samples, Timestamp stamp_ns) {
  return std::lower_bound(samples.begin(), samples.end(), stamp_ns,
                          [](const Sample& s, Timestamp stamp) { return s.stamp_ns < stamp; });
}

/// Angular rate at a time, linear between samples and held beyond the ends.
Eigen::Vector3d RateAt(const std::deque<ImuSample>& imu, Timestamp stamp_ns) {
  const auto after = FirstAtOrAfter(imu, stamp_ns);
  if (after == imu.begin()) return after->angular_velocity_rad_s;
  const auto before = std::prev(after);
  if (after == imu.end()) return before->angular_velocity_rad_s;
  const double fraction = SecondsBetween(before->stamp_ns, stamp_ns) /
                          SecondsBetween(before->stamp_ns, after->stamp_ns);
  return (1.0 - fraction) * before->angular_velocity_rad_s +
         fraction * after->angular_velocity_rad_s;
}

/// True when samples leave no hole over [from, to].
bool CoversWithoutHole(const std::deque<ImuSample>& imu, Timestamp from_ns, Timestamp to_ns) {
  if (imu.empty()) return false;
  auto it = FirstAtOrAfter(imu, from_ns);
  if (it == imu.end()) return SecondsBetween(imu.back().stamp_ns, to_ns) <= kMaxOverhangS;
  if (it == imu.begin() && SecondsBetween(from_ns, it->stamp_ns) > kMaxOverhangS) return false;
  if (it != imu.begin()) --it;
  for (; std::next(it) != imu.end() && it->stamp_ns < to_ns; ++it) {
    if (SecondsBetween(it->stamp_ns, std::next(it)->stamp_ns) > kMaxGapS) return false;
  }
  return SecondsBetween(it->stamp_ns, to_ns) <= kMaxOverhangS;
}

}  // namespace

MotionPrior::MotionPrior(const Rig& rig) {
  if (rig.imu) lidar_from_imu_ = rig.imu->lidar_from_imu;
  if (rig.odometry) lidar_from_body_ = rig.odometry->lidar_from_body;
}

void MotionPrior::AddImu(const ImuSample& sample) {
  if (!lidar_from_imu_) return;
  const bool finite =
      sample.angular_velocity_rad_s.allFinite() && sample.linear_acceleration_m_s2.allFinite();
  if (!finite || !InsertSorted(sample, &imu_)) ++num_refused_;
}

void MotionPrior::AddOdometry(const OdometrySample& sample) {
  if (!lidar_from_body_) return;
  const Rigid3& pose = sample.odom_from_body;
  const bool finite = pose.translation.allFinite() && pose.rotation.coeffs().allFinite();
  if (!finite || !InsertSorted(sample, &odometry_)) ++num_refused_;
}

void MotionPrior::ForgetBefore(Timestamp stamp_ns) {
  while (!imu_.empty() && imu_.front().stamp_ns < stamp_ns) imu_.pop_front();
  while (!odometry_.empty() && odometry_.front().stamp_ns < stamp_ns) odometry_.pop_front();
}

void MotionPrior::Clear() {
  imu_.clear();
  odometry_.clear();
  num_refused_ = 0;
}

std::optional<Eigen::Quaterniond> MotionPrior::RotationBetween(Timestamp from_ns,
                                                               Timestamp to_ns) const {
  if (from_ns > to_ns) {
    const auto reverse = RotationBetween(to_ns, from_ns);
    return reverse ? std::make_optional(reverse->conjugate()) : std::nullopt;
  }
  if (!lidar_from_imu_ || !CoversWithoutHole(imu_, from_ns, to_ns)) return std::nullopt;
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Timestamp start_ns = from_ns;
  Eigen::Vector3d start_rate = RateAt(imu_, start_ns);
  auto it =
      std::upper_bound(imu_.begin(), imu_.end(), from_ns,
                       [](Timestamp stamp, const ImuSample& s) { return stamp < s.stamp_ns; });
  while (start_ns < to_ns) {
    const Timestamp end_ns = it == imu_.end() ? to_ns : std::min(it->stamp_ns, to_ns);
    const Eigen::Vector3d end_rate = RateAt(imu_, end_ns);
    rotation = rotation * ExpSo3(0.5 * (start_rate + end_rate) * SecondsBetween(start_ns, end_ns));
    start_ns = end_ns;
    start_rate = end_rate;
    if (it != imu_.end()) ++it;
  }
  const Eigen::Quaterniond& q = lidar_from_imu_->rotation;
  return (q * rotation * q.conjugate()).normalized();
}

std::optional<Rigid3> MotionPrior::OdometryPoseAt(Timestamp stamp_ns) const {
  const auto after = FirstAtOrAfter(odometry_, stamp_ns);
  if (after == odometry_.end()) {
    // A sweep is handed on as soon as it ends, often before the next odometry sample arrives: the
    // last motion carries on for that little while.
    if (odometry_.size() < 2) return std::nullopt;
    const OdometrySample& last = odometry_.back();
    const OdometrySample& previous = odometry_[odometry_.size() - 2];
    const double step_s = SecondsBetween(previous.stamp_ns, last.stamp_ns);
    const double overhang_s = SecondsBetween(last.stamp_ns, stamp_ns);
    if (overhang_s > kMaxOverhangS || step_s > kMaxGapS) return std::nullopt;
    return InterpolateRigid3(previous.odom_from_body, last.odom_from_body,
                             1.0 + overhang_s / step_s);
  }
  if (after->stamp_ns == stamp_ns) return after->odom_from_body;
  if (after == odometry_.begin()) return std::nullopt;
  const auto before = std::prev(after);
  const double gap_s = SecondsBetween(before->stamp_ns, after->stamp_ns);
  if (gap_s > kMaxGapS) return std::nullopt;
  return InterpolateRigid3(before->odom_from_body, after->odom_from_body,
                           SecondsBetween(before->stamp_ns, stamp_ns) / gap_s);
}

std::optional<Rigid3> MotionPrior::MotionBetween(Timestamp from_ns, Timestamp to_ns) const {
  if (!lidar_from_body_) return std::nullopt;
  const auto from = OdometryPoseAt(from_ns);
  const auto to = OdometryPoseAt(to_ns);
  if (!from || !to) return std::nullopt;
  return *lidar_from_body_ * (from->Inverse() * *to) * lidar_from_body_->Inverse();
}

}  // namespace scenecalib
