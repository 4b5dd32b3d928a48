#include "problem_assembly.h"

#include <ceres/version.h>

#include <cmath>

#include "prior_costs.h"
#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

/// Mean of the correction over all knots: this close to zero.
constexpr double kZeroMeanRotation_rad = 1e-6;
constexpr double kZeroMeanTranslation_m = 1e-5;
/// A mean ties the knots that it is taken over to each other, all with all, and the factorisation
/// fills in accordingly: on a drive of minutes it cost most of the solve's time and memory. So many
/// knots, evenly spread, say the same.
constexpr std::size_t kMaxKnotsInMean = 256;

Vector6d Stack(double rotation, double translation) {
  Vector6d v;
  v << rotation, rotation, rotation, translation, translation, translation;
  return v;
}

void AddPrior(AssembledProblem* assembled, const Eigen::VectorXd& mean,
              const Eigen::MatrixXd& root_information, double* block) {
  if (!assembled->problem->HasParameterBlock(block)) return;
  assembled->priors.push_back(
      assembled->problem->AddResidualBlock(new PriorCost(mean, root_information), nullptr, block));
}

/// Root of the information of a vector known by standard deviations along a camera's axes.
Eigen::Matrix3d AlongCamera(const Eigen::Vector3d& sigma, const Rigid3& lidar_from_camera) {
  return sigma.cwiseInverse().asDiagonal() * lidar_from_camera.RotationMatrix().transpose();
}

void AddCameraPriors(const CalibrationProblem& p, AssembledProblem* assembled) {
  for (std::size_t c = 0; c < p.cameras->size(); ++c) {
    CameraParameters& camera = (*p.cameras)[c];
    const CameraPrior& prior = p.priors[c];
    // Deltas are about the base, so the prior's mean is where the initial pose lies from there.
    const Eigen::Vector3d rotation_mean =
        LogSo3(prior.initial_lidar_from_camera.rotation *
               camera.base_lidar_from_camera.rotation.conjugate());
    const Eigen::Vector3d translation_mean =
        prior.initial_lidar_from_camera.translation - camera.base_lidar_from_camera.translation;
    AddPrior(assembled, rotation_mean,
             AlongCamera(prior.rotation_rad, prior.initial_lidar_from_camera),
             camera.rotation_delta_rad.data());
    AddPrior(assembled, translation_mean,
             AlongCamera(prior.translation_m, prior.initial_lidar_from_camera),
             camera.translation_delta_m.data());
    AddPrior(assembled, prior.initial_intrinsics,
             p.intrinsics_prior_weight *
                 prior.IntrinsicsStddev().cwiseInverse().asDiagonal().toDenseMatrix(),
             camera.intrinsics.data());
    AddPrior(
        assembled, Eigen::VectorXd::Constant(1, prior.initial_time_offset_s - p.time_offset_s[c]),
        Eigen::MatrixXd::Constant(1, 1, 1.0 / prior.time_offset_s), &camera.time_offset_delta_s);
  }
}

void AddCorrectionPriors(const CalibrationProblem& p, AssembledProblem* assembled) {
  const double root_spacing = std::sqrt(p.correction->knot_spacing_s());
  const Vector6d walk = root_spacing * Stack(p.correction_prior.walk_rotation_rad,
                                             p.correction_prior.walk_translation_m);
  std::vector<Vector6d>& knots = p.correction->knots();
  const std::size_t stride = (knots.size() + kMaxKnotsInMean - 1) / kMaxKnotsInMean;
  std::vector<double*> averaged;
  for (std::size_t k = 0; k < knots.size(); ++k) {
    if (k % stride == 0) averaged.push_back(knots[k].data());
    if (k == 0) continue;
    assembled->priors.push_back(assembled->problem->AddResidualBlock(
        new WalkCost(walk), nullptr, knots[k - 1].data(), knots[k].data()));
  }
  assembled->priors.push_back(assembled->problem->AddResidualBlock(
      new ZeroMeanCost(static_cast<int>(averaged.size()),
                       Stack(kZeroMeanRotation_rad, kZeroMeanTranslation_m)),
      nullptr, averaged));
}

/// Ends a solve at a step that is refused for next to nothing. Near the solution a single term that
/// is far from linear (a ray that grazes its plane) can refuse one full step after the other, each
/// at the cost of a whole evaluation, until damping makes them too small to matter.
class EndAtIdleStep : public ceres::IterationCallback {
 public:
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& step) override {
    const bool is_idle =
        !step.step_is_successful && std::abs(step.cost_change) < kIdleChange * std::abs(step.cost);
    return is_idle ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

 private:
  static constexpr double kIdleChange = 1e-5;  // of the cost
};

}  // namespace

AssembledProblem AssembleProblem(const CalibrationProblem& p) {
  AssembledProblem assembled;
  assembled.preparation = std::make_unique<GroupPreparation>();
  ceres::Problem::Options problem_options;
#if CERES_VERSION_MAJOR >= 2
  problem_options.evaluation_callback = assembled.preparation.get();
#endif
  assembled.problem = std::make_unique<ceres::Problem>(problem_options);
  assembled.groups = GroupTerms(p);
  for (const auto& group : assembled.groups) {
    auto* cost = new TermGroupCost(group.get());
    assembled.costs.push_back(cost);
    assembled.problem->AddResidualBlock(cost, nullptr, group->blocks());
  }
  AddCameraPriors(p, &assembled);
  if (p.free.correction) AddCorrectionPriors(p, &assembled);
  const auto keep = [&assembled](double* block) {
    if (assembled.problem->HasParameterBlock(block)) assembled.blocks.push_back(block);
  };
  for (std::size_t c = 0; c < p.cameras->size(); ++c) {
    CameraParameters& camera = (*p.cameras)[c];
    keep(camera.rotation_delta_rad.data());
    keep(camera.translation_delta_m.data());
    keep(camera.intrinsics.data());
    keep(&camera.time_offset_delta_s);
  }
  if (p.free.correction) {
    for (Vector6d& knot : p.correction->knots()) keep(knot.data());
  }
  return assembled;
}

void SolveAssembled(const AssembledProblem& assembled, ceres::Solver::Options options,
                    ceres::Solver::Summary* summary) {
#if CERES_VERSION_MAJOR < 2
  options.evaluation_callback = assembled.preparation.get();
#endif
  EndAtIdleStep end_at_idle_step;
  options.callbacks.push_back(&end_at_idle_step);
  assembled.preparation->costs = assembled.costs;
  ceres::Solve(options, assembled.problem.get(), summary);
  assembled.preparation->costs.clear();  // whoever evaluates the priors alone needs no groups
}

}  // namespace scenecalib
