#include "transfer_cost.h"

#include <algorithm>

namespace scenecalib {
namespace {

/// Writes a Jacobian block in the row-major order of Ceres.
template <int kColumns>
void Store(const Eigen::Matrix<double, 2, kColumns>& jacobian, double* out) {
  for (int row = 0; row < 2; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      out[row * kColumns + column] = jacobian(row, column);
    }
  }
}

}  // namespace

TransferCost::TransferCost(const TransferTerm* term, std::vector<CameraParameters>* cameras,
                           TrajectoryCorrection* correction, const FreeParameters& free,
                           double scale)
    : term_(term), cameras_(cameras), correction_(correction), free_(free), scale_(scale) {
  set_num_residuals(2);
  AddCamera(term->source_camera);
  if (term->target_camera != term->source_camera) AddCamera(term->target_camera);
  if (free.correction) {
    AddKnot(term->source_place.index);
    AddKnot(term->source_place.index + 1);
    AddKnot(term->target_place.index);
    AddKnot(term->target_place.index + 1);
  }
}

void TransferCost::AddBlock(Kind kind, int owner, double* values, int size) {
  layout_.push_back({kind, owner});
  blocks_.push_back(values);
  mutable_parameter_block_sizes()->push_back(size);
}

void TransferCost::AddCamera(int camera) {
  CameraParameters& parameters = (*cameras_)[camera];
  if (free_.rotation) AddBlock(Kind::kRotation, camera, parameters.rotation_delta_rad.data(), 3);
  if (free_.translation) {
    AddBlock(Kind::kTranslation, camera, parameters.translation_delta_m.data(), 3);
  }
  if (free_.intrinsics) AddBlock(Kind::kIntrinsics, camera, parameters.intrinsics.data(), 3);
  if (free_.time_offset) {
    AddBlock(Kind::kTimeOffset, camera, &parameters.time_offset_delta_s, 1);
  }
}

void TransferCost::AddKnot(int knot) {
  const auto same = [knot](const Block& b) { return b.kind == Kind::kKnot && b.owner == knot; };
  if (std::any_of(layout_.begin(), layout_.end(), same)) return;
  AddBlock(Kind::kKnot, knot, correction_->knots()[knot].data(), 6);
}

double TransferCost::KnotWeight(const TrajectoryCorrection::Place& place, int knot) const {
  if (knot == place.index) return 1.0 - place.fraction;
  if (knot == place.index + 1) return place.fraction;
  return 0.0;
}

void TransferCost::FillJacobian(const TransferJacobians& all, const Block& block,
                                double* out) const {
  const Eigen::Matrix2d weight = scale_ * term_->whitening;
  const bool is_source = block.owner == term_->source_camera;
  const bool is_target = block.owner == term_->target_camera;
  // Where source and target are one camera, its parameters act through both ends.
  const auto both = [&](auto member) {
    Eigen::Matrix<double, 2, 3> sum = Eigen::Matrix<double, 2, 3>::Zero();
    if (is_source) sum += all.source.*member;
    if (is_target) sum += all.target.*member;
    return Eigen::Matrix<double, 2, 3>(weight * sum);
  };
  switch (block.kind) {
    case Kind::kRotation:
      Store<3>(both(&TransferViewJacobians::by_rotation), out);
      break;
    case Kind::kTranslation:
      Store<3>(both(&TransferViewJacobians::by_translation), out);
      break;
    case Kind::kIntrinsics:
      Store<3>(both(&TransferViewJacobians::by_intrinsics), out);
      break;
    case Kind::kTimeOffset: {
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      if (is_source) sum += all.source.by_correction * term_->source.twist_in_lidar;
      if (is_target) sum += all.target.by_correction * term_->target.twist_in_lidar;
      Store<1>(weight * sum, out);
      break;
    }
    case Kind::kKnot:
      Store<6>(weight * (KnotWeight(term_->source_place, block.owner) * all.source.by_correction +
                         KnotWeight(term_->target_place, block.owner) * all.target.by_correction),
               out);
      break;
  }
}

bool TransferCost::Evaluate(double const* const* parameters, double* residuals,
                            double** jacobians) const {
  CameraParameters source_camera = (*cameras_)[term_->source_camera];
  CameraParameters target_camera = (*cameras_)[term_->target_camera];
  Vector6d source_correction = Vector6d::Zero();
  Vector6d target_correction = Vector6d::Zero();
  if (!free_.correction) {
    source_correction = correction_->At(term_->source_place);
    target_correction = correction_->At(term_->target_place);
  }
  for (std::size_t i = 0; i < layout_.size(); ++i) {
    const Block& block = layout_[i];
    const double* values = parameters[i];
    if (block.kind == Kind::kKnot) {
      const Eigen::Map<const Vector6d> knot(values);
      source_correction += KnotWeight(term_->source_place, block.owner) * knot;
      target_correction += KnotWeight(term_->target_place, block.owner) * knot;
      continue;
    }
    for (CameraParameters* camera : {&source_camera, &target_camera}) {
      const int index = camera == &source_camera ? term_->source_camera : term_->target_camera;
      if (index != block.owner) continue;
      if (block.kind == Kind::kTimeOffset) {
        camera->time_offset_delta_s = values[0];
        continue;
      }
      const Eigen::Map<const Eigen::Vector3d> vector(values);
      if (block.kind == Kind::kRotation) camera->rotation_delta_rad = vector;
      if (block.kind == Kind::kTranslation) camera->translation_delta_m = vector;
      if (block.kind == Kind::kIntrinsics) camera->intrinsics = vector;
    }
  }
  Eigen::Vector2d residual;
  TransferJacobians all;
  if (!EvaluateTransfer(term_->source, source_camera, source_correction, term_->target,
                        target_camera, target_correction, term_->plane_point_in_map_m,
                        term_->plane_normal_in_map, &residual, jacobians ? &all : nullptr)) {
    return false;
  }
  Eigen::Map<Eigen::Vector2d> mapped(residuals);
  mapped = scale_ * (term_->whitening * residual);
  if (jacobians == nullptr) return true;
  for (std::size_t i = 0; i < layout_.size(); ++i) {
    if (jacobians[i] != nullptr) FillJacobian(all, layout_[i], jacobians[i]);
  }
  return true;
}

}  // namespace scenecalib
