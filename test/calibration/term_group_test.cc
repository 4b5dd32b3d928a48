#include <tuple>

#include "../../src/calibration/term_group_cost.h"
#include "calibration/downward_rig.h"
#include "scenecalib/base/random.h"
#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

/// Two cameras that look down on the ground z = 0 from a lidar 10 m above it, which moves along x
/// for three seconds.
class TermGroupTest : public testing::DownwardRig {
 protected:
  TermGroupTest() : DownwardRig(2), correction_(0, AddSeconds(0, 3.0), 0.5) {
    problem_.cameras = &cameras_;
    problem_.correction = &correction_;
    problem_.free.intrinsics = true;
    problem_.free.time_offset = true;
    problem_.free.correction = true;
    problem_.residual_sigma = 0.7;
    Random random(3);
    for (int i = 0; i < 40; ++i) problem_.terms.push_back(MakeTerm(&random));
  }

  TransferView ViewAt(double time_s, Random* random) const {
    TransferView view;
    view.map_from_lidar.translation = {time_s, 0.1 * time_s, 10.0};
    view.twist_in_lidar << 0.0, 0.0, 0.02, 1.0, 0.1, 0.0;
    view.pixel = {random->Uniform(300.0, 700.0), random->Uniform(300.0, 700.0)};
    return view;
  }

  TransferTerm MakeTerm(Random* random) const {
    TransferTerm term;
    term.source_camera = random->Uniform() < 0.5 ? 0 : 1;
    term.target_camera = random->Uniform() < 0.5 ? 0 : 1;
    const double source_s = random->Uniform(0.0, 3.0);
    const double target_s = random->Uniform(0.0, 3.0);
    term.source = ViewAt(source_s, random);
    term.target = ViewAt(target_s, random);
    term.source_place = correction_.Locate(AddSeconds(0, source_s));
    term.target_place = correction_.Locate(AddSeconds(0, target_s));
    term.target_stamp_ns = AddSeconds(0, target_s);
    // Residuals of hundreds of pixels, some of which the robust loss has to take down.
    term.whitening << 0.01, 0.002, 0.0, 0.02;
    return term;
  }

  /// Twice Ceres' cost at the parameters as they are.
  double CostOf(const TermGroup& group) const {
    GroupEquations equations;
    EXPECT_TRUE(group.Evaluate(group.blocks().data(), false, &equations));
    return equations.cost;
  }

  TrajectoryCorrection correction_;
  CalibrationProblem problem_;
};

TEST_F(TermGroupTest, EveryTermIsInOneGroupOfItsSecond) {
  std::size_t num_seconds = 0;
  Timestamp last = -1;
  for (const auto& group : GroupTerms(problem_)) {
    EXPECT_GE(group->target_second(), last) << "in the order of time";
    if (group->target_second() != last) ++num_seconds;
    last = group->target_second();
  }
  EXPECT_EQ(num_seconds, 3U);
}

TEST_F(TermGroupTest, GradientIsThatOfTheCost) {
  for (const auto& group : GroupTerms(problem_)) {
    GroupEquations equations;
    ASSERT_TRUE(group->Evaluate(group->blocks().data(), true, &equations));
    EXPECT_NEAR(equations.cost, CostOf(*group), 1e-9 * equations.cost);
    int column = 0;
    for (std::size_t b = 0; b < group->blocks().size(); ++b) {
      for (int k = 0; k < group->block_sizes()[b]; ++k, ++column) {
        double& value = group->blocks()[b][k];
        const double before = value;
        const double step = 1e-5;
        value = before + step;
        const double after_step = CostOf(*group);
        value = before - step;
        const double before_step = CostOf(*group);
        value = before;
        const double expected = 0.5 * (after_step - before_step) / (2.0 * step);
        EXPECT_NEAR(equations.gradient[column], expected, 1e-4 * std::max(1.0, std::abs(expected)));
      }
    }
  }
}

TEST_F(TermGroupTest, CeresSeesTheSameEquationsAndCost) {
  for (const auto& group : GroupTerms(problem_)) {
    GroupEquations equations;
    ASSERT_TRUE(group->Evaluate(group->blocks().data(), true, &equations));
    const TermGroupCost cost(group.get());
    const int n = group->num_columns();
    Eigen::VectorXd residuals(n + 1);
    std::vector<std::vector<double>> storage;
    std::vector<double*> jacobians;
    for (const int size : group->block_sizes()) storage.emplace_back((n + 1) * size);
    for (auto& block : storage) jacobians.push_back(block.data());
    ASSERT_TRUE(cost.Evaluate(group->blocks().data(), residuals.data(), jacobians.data()));
    Eigen::MatrixXd jacobian(n + 1, n);
    int column = 0;
    for (std::size_t b = 0; b < storage.size(); ++b) {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      const int size = group->block_sizes()[b];
      jacobian.middleCols(column, size) = Eigen::Map<RowMajor>(storage[b].data(), n + 1, size);
      column += size;
    }
    const Eigen::MatrixXd information = equations.information.selfadjointView<Eigen::Lower>();
    const double scale = information.cwiseAbs().maxCoeff();
    EXPECT_LT((jacobian.transpose() * jacobian - information).cwiseAbs().maxCoeff(), 1e-9 * scale);
    EXPECT_LT((jacobian.transpose() * residuals - equations.gradient).norm(),
              1e-6 * equations.gradient.norm());
    EXPECT_NEAR(residuals.squaredNorm(), equations.cost, 1e-9 * equations.cost);
    Eigen::VectorXd without(n + 1);
    ASSERT_TRUE(cost.Evaluate(group->blocks().data(), without.data(), nullptr));
    EXPECT_NEAR(without.squaredNorm(), equations.cost, 1e-9 * equations.cost);
  }
}

TEST_F(TermGroupTest, PreparationChangesNothingThatCeresSees) {
  const auto groups = GroupTerms(problem_);
  std::vector<std::unique_ptr<TermGroupCost>> prepared;
  GroupPreparation preparation;
  for (const auto& group : groups) {
    prepared.push_back(std::make_unique<TermGroupCost>(group.get()));
    preparation.costs.push_back(prepared.back().get());
  }
  for (const double shift : {0.0, 0.01}) {  // the second: what was prepared before is out of date
    for (CameraParameters& camera : cameras_) camera.translation_delta_m.x() = shift;
    preparation.PrepareForEvaluation(false, true);
    preparation.PrepareForEvaluation(true, false);
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const int n = groups[g]->num_columns() + 1;
      Eigen::MatrixXd jacobian[2] = {Eigen::MatrixXd(n, n - 1), Eigen::MatrixXd(n, n - 1)};
      Eigen::VectorXd residuals[2] = {Eigen::VectorXd(n), Eigen::VectorXd(n)};
      const TermGroupCost fresh(groups[g].get());
      const TermGroupCost* costs[2] = {prepared[g].get(), &fresh};
      for (int i = 0; i < 2; ++i) {
        std::vector<double*> blocks;
        double* block = jacobian[i].data();
        for (const int size : groups[g]->block_sizes()) {
          blocks.push_back(block);
          block += n * size;
        }
        ASSERT_TRUE(
            costs[i]->Evaluate(groups[g]->blocks().data(), residuals[i].data(), blocks.data()));
      }
      EXPECT_EQ(jacobian[0], jacobian[1]);
      EXPECT_EQ(residuals[0], residuals[1]);
    }
  }
}

TEST_F(TermGroupTest, ATermThatCannotBeEvaluatedIsNoZeroResidual) {
  problem_.terms[7].plane_point_in_map_m.z() = 20.0;  // behind the cameras
  bool failed = false;
  for (const auto& group : GroupTerms(problem_)) {
    GroupEquations equations;
    failed = failed || !group->Evaluate(group->blocks().data(), false, &equations);
  }
  EXPECT_TRUE(failed);
}

/// As TermGroupTest, with lenses and clocks that are changed.
class MisfitsOfATermGroup : public TermGroupTest {
 protected:
  void Bend(int camera, double change) {
    bent_[camera] = WithRadialChange(*model_, change).value();
    cameras_[camera].model = bent_[camera].get();
  }
  std::vector<RadialField> Fields() const {
    return {RadialField(*model_, cameras_[0].Intrinsics()),
            RadialField(*model_, cameras_[1].Intrinsics())};
  }

  /// Where a camera's three misfits begin: its lens, its line time and its time offset.
  static Eigen::Index LensOf(int camera) { return TermGroup::kNumMisfits * camera; }

  CameraModelPtr bent_[2];
};

TEST_F(MisfitsOfATermGroup, GradientIsThatOfTheCost) {
  constexpr double kChange = 1e-5;
  for (const auto& group : GroupTerms(problem_)) {
    MisfitEquations equations;
    ASSERT_TRUE(group->EvaluateMisfits(Fields(), &equations));
    for (int camera = 0; camera < 2; ++camera) {
      Bend(camera, kChange);
      const double more = CostOf(*group);
      Bend(camera, -kChange);
      const double less = CostOf(*group);
      Bend(camera, 0.0);
      const double expected = 0.5 * (more - less) / (2.0 * kChange);
      // The field is read between the nodes of a grid.
      EXPECT_NEAR(equations.gradient[LensOf(camera)], expected,
                  1e-2 * std::max(1.0, std::abs(expected)));
    }
  }
}

TEST_F(MisfitsOfATermGroup, GradientByTheClocksIsThatOfTheCost) {
  // The cost when the images of one camera are so much later, and each row than the row above.
  const auto costs = [this](int camera, double offset_s, double line_time_s) {
    CalibrationProblem changed = problem_;
    const auto delay = [&](TransferView* view) {
      const double late_s = offset_s + line_time_s * view->pixel.y();
      view->map_from_lidar = ApplyCorrection(view->map_from_lidar, late_s * view->twist_in_lidar);
    };
    for (TransferTerm& term : changed.terms) {
      if (term.source_camera == camera) delay(&term.source);
      if (term.target_camera == camera) delay(&term.target);
    }
    std::vector<double> result;
    for (const auto& group : GroupTerms(changed)) result.push_back(CostOf(*group));
    return result;
  };
  const auto groups = GroupTerms(problem_);
  for (int camera = 0; camera < 2; ++camera) {
    for (const auto& [misfit, offset_s, line_time_s] :
         {std::make_tuple(1, 0.0, 1e-7), std::make_tuple(2, 1e-4, 0.0)}) {
      const std::vector<double> more = costs(camera, offset_s, line_time_s);
      const std::vector<double> less = costs(camera, -offset_s, -line_time_s);
      for (std::size_t g = 0; g < groups.size(); ++g) {
        MisfitEquations equations;
        ASSERT_TRUE(groups[g]->EvaluateMisfits(Fields(), &equations));
        const double expected = 0.5 * (more[g] - less[g]) / (2.0 * (offset_s + line_time_s));
        EXPECT_NEAR(equations.gradient[LensOf(camera) + misfit], expected,
                    1e-4 * std::max(1.0, std::abs(expected)));
      }
    }
  }
}

TEST_F(MisfitsOfATermGroup, EquationsAreTheDerivativesWhereTheResidualsVanish) {
  constexpr double kChange = 1e-5;
  for (TransferTerm& term : problem_.terms) {
    // The point that the source sees, on the ground 10 m below.
    const Eigen::Vector2d offset = (term.source.pixel - Eigen::Vector2d(500.0, 500.0)) / kFocalPx;
    const Eigen::Vector3d point = term.source.map_from_lidar.translation +
                                  cameras_[term.source_camera].base_lidar_from_camera.translation +
                                  Eigen::Vector3d(10.0 * offset.x(), -10.0 * offset.y(), -10.0);
    term.target.pixel =
        See(cameras_[term.target_camera], term.target.map_from_lidar.translation, point);
  }
  for (const auto& group : GroupTerms(problem_)) {
    MisfitEquations equations;
    ASSERT_TRUE(group->EvaluateMisfits(Fields(), &equations));
    EXPECT_NEAR(equations.gradient.norm(), 0.0, 1e-6 * equations.information.norm());
    for (int camera = 0; camera < 2; ++camera) {
      Bend(camera, kChange);
      GroupEquations more;
      MisfitEquations of_misfits;
      ASSERT_TRUE(group->Evaluate(group->blocks().data(), true, &more));
      ASSERT_TRUE(group->EvaluateMisfits(Fields(), &of_misfits));
      Bend(camera, 0.0);
      const Eigen::VectorXd coupling = more.gradient / kChange;
      EXPECT_LT((equations.coupling.col(LensOf(camera)) - coupling).norm(), 5e-3 * coupling.norm());
      const Eigen::VectorXd information = of_misfits.gradient / kChange;
      // Of each row, what it would be if it were fully correlated.
      const Eigen::VectorXd scale =
          (equations.information.diagonal() * equations.information(LensOf(camera), LensOf(camera)))
              .cwiseSqrt();
      const Eigen::VectorXd error = equations.information.col(LensOf(camera)) - information;
      EXPECT_LT(error.cwiseQuotient(scale).cwiseAbs().maxCoeff(), 5e-3);
    }
  }
}

}  // namespace
}  // namespace scenecalib
