#include "scenecalib/simulation/inertial.h"

#include <Eigen/Geometry>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {

namespace {

Eigen::Vector3d GaussianVector(Random* random, double deviation) {
  const double x = random->Gaussian();
  const double y = random->Gaussian();
  const double z = random->Gaussian();
  return deviation * Eigen::Vector3d(x, y, z);
}

}  // namespace

ImuSample PerfectImu(const VehicleState& state, const Rigid3& vehicle_from_imu) {
  const Eigen::Vector3d& rate = state.angular_velocity_in_vehicle_rad_s;
  const Eigen::Vector3d& lever_m = vehicle_from_imu.translation;
  const Eigen::Quaterniond vehicle_from_map = state.map_from_vehicle.rotation.conjugate();
  const Eigen::Vector3d gravity(0.0, 0.0, -kGravityM_s2);
  const Eigen::Vector3d force = vehicle_from_map * (state.acceleration_in_map_m_s2 - gravity) +
                                state.angular_acceleration_in_vehicle_rad_s2.cross(lever_m) +
                                rate.cross(rate.cross(lever_m));
  const Eigen::Quaterniond imu_from_vehicle = vehicle_from_imu.rotation.conjugate();
  ImuSample sample;
  sample.angular_velocity_rad_s = imu_from_vehicle * rate;
  sample.linear_acceleration_m_s2 = imu_from_vehicle * force;
  return sample;
}

std::vector<ImuSample> SimulateImu(const std::vector<Timestamp>& stamps_ns,
                                   const std::function<VehicleState(Timestamp)>& state_at,
                                   const Rigid3& vehicle_from_imu,
                                   const SimulatedImuOptions& options, Random random) {
  Eigen::Vector3d gyro_bias = GaussianVector(&random, options.gyro_bias_rad_s);
  Eigen::Vector3d acceleration_bias = GaussianVector(&random, options.acceleration_bias_m_s2);
  const double step_share = std::sqrt(1.0 / options.rate_hz);
  std::vector<ImuSample> samples;
  samples.reserve(stamps_ns.size());
  for (const Timestamp stamp_ns : stamps_ns) {
    ImuSample sample = PerfectImu(state_at(stamp_ns), vehicle_from_imu);
    sample.stamp_ns = stamp_ns;
    sample.angular_velocity_rad_s += gyro_bias + GaussianVector(&random, options.gyro_noise_rad_s);
    sample.linear_acceleration_m_s2 +=
        acceleration_bias + GaussianVector(&random, options.acceleration_noise_m_s2);
    samples.push_back(sample);
    gyro_bias += GaussianVector(&random, options.gyro_walk_rad_s_sqrt_s * step_share);
    acceleration_bias +=
        GaussianVector(&random, options.acceleration_walk_m_s2_sqrt_s * step_share);
  }
  return samples;
}

std::vector<OdometrySample> SimulateOdometry(
    const std::vector<Timestamp>& stamps_ns,
    const std::function<Rigid3(Timestamp)>& map_from_body_at,
    const SimulatedOdometryOptions& options, Random random) {
  const double scale = 1.0 + options.scale_error * random.Gaussian();
  const double yaw_drift_rad_s = options.yaw_drift_deg_s * random.Gaussian() * M_PI / 180.0;
  const double noise_rad = options.noise_deg * M_PI / 180.0;
  std::vector<OdometrySample> samples;
  samples.reserve(stamps_ns.size());
  Rigid3 odom_from_body;
  Rigid3 map_from_last;
  for (std::size_t i = 0; i < stamps_ns.size(); ++i) {
    const Rigid3 map_from_body = map_from_body_at(stamps_ns[i]);
    if (i > 0) {
      const double step_s = SecondsBetween(stamps_ns[i - 1], stamps_ns[i]);
      Rigid3 last_from_body = map_from_last.Inverse() * map_from_body;
      last_from_body.translation =
          scale * last_from_body.translation + GaussianVector(&random, options.noise_m);
      const Eigen::Vector3d drift =
          GaussianVector(&random, noise_rad) + Eigen::Vector3d(0.0, 0.0, yaw_drift_rad_s * step_s);
      last_from_body.rotation = (last_from_body.rotation * ExpSo3(drift)).normalized();
      odom_from_body = odom_from_body * last_from_body;
    }
    samples.push_back({stamps_ns[i], odom_from_body});
    map_from_last = map_from_body;
  }
  return samples;
}

}  // namespace scenecalib
