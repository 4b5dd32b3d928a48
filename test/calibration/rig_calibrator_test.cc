#include "scenecalib/calibration/rig_calibrator.h"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <chrono>
#include <numeric>
#include <string>
#include <thread>

#include "scenecalib/calibration/camera_calibration.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/sensor/lens_shape.h"
#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

using testing::CanyonCamera;
using testing::CanyonOptions;
using testing::CanyonScene;
using testing::MakeCanyonScene;
using testing::Perturb;

constexpr double kDegPerRad = 57.29577951308232;

struct PoseError {
  double rotation_deg;
  double translation_m;
};

PoseError ErrorOf(const CameraConfig& truth, const CameraConfig& estimate) {
  const Rigid3 error = truth.lidar_from_camera.Inverse() * estimate.lidar_from_camera;
  return {kDegPerRad * LogSo3(error.rotation).norm(), error.translation.norm()};
}

std::vector<CameraConfig> TwoCameras() {
  return {CanyonCamera("front", 0.0, 680.0, false), CanyonCamera("left", 1.2, 330.0, true)};
}

CalibrationOptions HeldIntrinsics() {
  CalibrationOptions options;
  options.hold_intrinsics = true;
  options.joint.register_through_map = false;  // these scenes have no images
  return options;
}

TEST(RigCalibrator, RecoversTheTruthFromTwoDegreesAndTwentyCentimetres) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  for (const std::uint64_t seed : {1, 2, 3}) {
    const Rig initial = Perturb(scene.rig, 2.0 / kDegPerRad, 0.2, seed);
    const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
    ASSERT_TRUE(calibration.ok()) << calibration.status().message();
    for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
      const CameraQuality& quality = calibration->result.cameras[c];
      EXPECT_TRUE(quality.accepted) << (quality.reasons.empty() ? "" : quality.reasons[0]);
      EXPECT_LT(quality.rms_after_px, quality.rms_before_px);
      // Exact planes and 0.05 px of noise over some hundred tracks: well below these.
      const PoseError error = ErrorOf(scene.rig.cameras[c], calibration->result.rig.cameras[c]);
      EXPECT_LT(error.rotation_deg, 0.03);
      EXPECT_LT(error.translation_m, 0.015);
    }
  }
}

TEST(AssociateAndBuildTerms, CountsWhatRegistrationThroughTheMapDroppedByItself) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  std::vector<Track> tracks = scene.segments[0].tracks;
  ASSERT_GT(tracks.size(), 100U);
  for (std::size_t i = 0; i < 10; ++i) tracks[3 * i].observations.clear();
  const std::vector<CameraParameters> cameras = {InitialParameters(scene.rig.cameras[0])};
  const TrajectoryCorrection no_correction;
  CameraContext context;
  context.parameters = &cameras[0];
  context.map_from_lidar = &scene.map.map_from_lidar;
  context.correction = &no_correction;
  const auto caster = RayCaster::Create(scene.map);
  ASSERT_TRUE(caster.ok());
  const CalibrationOptions options;
  std::array<int, kNumAssociationOutcomes> counts{};
  AssociateAndBuildTerms(context, cameras, tracks, *caster,
                         GatesOfRound(options.coarse_to_fine, options.coarse_to_fine.num_rounds),
                         options, &counts);
  EXPECT_EQ(counts[static_cast<std::size_t>(AssociationOutcome::kNotAsPredicted)], 10);
  EXPECT_GT(counts[static_cast<std::size_t>(AssociationOutcome::kAccepted)], 50);
  EXPECT_EQ(std::accumulate(counts.begin(), counts.end(), 0), static_cast<int>(tracks.size()));
}

TEST(RigCalibrator, TrajectoryCorrectionAbsorbsSmoothTrajectoryErrors) {
  CanyonOptions canyon;
  canyon.trajectory_error_m = 0.01;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), canyon);
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 5);
  CalibrationOptions fixed = HeldIntrinsics();
  fixed.joint.correct_trajectory = false;
  const auto with = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  const auto without = CalibrateRig(initial, scene.map, scene.segments, fixed, {});
  ASSERT_TRUE(with.ok() && without.ok());
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    EXPECT_LT(with->result.cameras[c].rms_after_px, 0.5 * without->result.cameras[c].rms_after_px);
    EXPECT_LT(ErrorOf(scene.rig.cameras[c], with->result.rig.cameras[c]).translation_m, 0.025);
  }
}

/// The rig with focal lengths and principal points that are not the truth's.
Rig WithWrongIntrinsics(const Rig& rig) {
  Rig wrong = rig;
  for (CameraConfig& camera : wrong.cameras) {
    TunableIntrinsics tunable = camera.model->tunable();
    tunable.focal_scale = 1.004;
    tunable.principal_point_px += Eigen::Vector2d(3.0, -2.0);
    camera.model = camera.model->WithTunable(tunable).value();
  }
  return wrong;
}

TEST(RigCalibrator, RefinesIntrinsicsOnADriveWithTurns) {
  CanyonOptions canyon;
  canyon.tracks_per_camera = 1500;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), canyon);
  CalibrationOptions options = HeldIntrinsics();
  options.hold_intrinsics = false;
  const auto calibration =
      CalibrateRig(WithWrongIntrinsics(Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8)), scene.map,
                   scene.segments, options, {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    const Eigen::Vector2d error =
        calibration->result.rig.cameras[c].model->tunable().principal_point_px -
        scene.rig.cameras[c].model->tunable().principal_point_px;
    EXPECT_LT(error.norm(), 1.0) << scene.rig.cameras[c].name;  // of 3.6 px at the start
    EXPECT_GT(calibration->result.cameras[c].stddev.focal_scale, 0.0);
  }
}

TEST(RigCalibrator, HasSettledAfterItsRounds) {
  CanyonOptions canyon;
  canyon.tracks_per_camera = 1500;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), canyon);
  const Rig initial = WithWrongIntrinsics(Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8));
  CalibrationOptions options = HeldIntrinsics();
  options.hold_intrinsics = false;
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, options, {});
  options.joint.num_rounds += 4;
  const auto longer = CalibrateRig(initial, scene.map, scene.segments, options, {});
  ASSERT_TRUE(calibration.ok() && longer.ok());
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    const Eigen::Vector2d change =
        longer->result.rig.cameras[c].model->tunable().principal_point_px -
        calibration->result.rig.cameras[c].model->tunable().principal_point_px;
    const CameraQuality& quality = calibration->result.cameras[c];
    EXPECT_LT(change.cwiseQuotient(quality.stddev.principal_point_px).cwiseAbs().maxCoeff(), 0.1)
        << scene.rig.cameras[c].name;
  }
}

/// The rig with radial coefficients that are not the truth's.
Rig WithWrongLenses(const Rig& rig, double change) {
  Rig wrong = rig;
  for (CameraConfig& camera : wrong.cameras) {
    camera.model = WithRadialChange(*camera.model, change).value();
  }
  return wrong;
}

TEST(RigCalibrator, RefinesTheLensesWhenAskedTo) {
  constexpr double kChange = 0.01;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  const Rig initial = WithWrongLenses(Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8), kChange);
  CalibrationOptions options = HeldIntrinsics();
  options.estimate_distortion = true;
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, options, {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    const CameraConfig& truth = scene.rig.cameras[c];
    const CameraConfig& result = calibration->result.rig.cameras[c];
    EXPECT_NEAR(RadialCoefficient(*result.model), RadialCoefficient(*truth.model), 0.05 * kChange)
        << truth.name;
    EXPECT_LT(ErrorOf(truth, result).rotation_deg, 0.03) << truth.name;
    EXPECT_LT(ErrorOf(truth, result).translation_m, 0.015) << truth.name;
    // What was to be held is.
    EXPECT_EQ(result.model->tunable().principal_point_px,
              truth.model->tunable().principal_point_px);
  }
}

TEST(RigCalibrator, ALensThatDoesNotFitIsToldOfAndWidensTheDeviations) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  const Rig perturbed = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8);
  const auto says_so = [](const CameraQuality& quality) {
    return std::any_of(quality.reasons.begin(), quality.reasons.end(), [](const std::string& text) {
      return text.find("lens does not fit") != std::string::npos;
    });
  };
  const auto good = CalibrateRig(perturbed, scene.map, scene.segments, HeldIntrinsics(), {});
  const auto bad = CalibrateRig(WithWrongLenses(perturbed, 0.01), scene.map, scene.segments,
                                HeldIntrinsics(), {});
  ASSERT_TRUE(good.ok() && bad.ok());
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    const CameraQuality& fits = good->result.cameras[c];
    const CameraQuality& does_not = bad->result.cameras[c];
    EXPECT_FALSE(says_so(fits));
    EXPECT_TRUE(says_so(does_not));
    EXPECT_GT(does_not.stddev.translation_m.norm(), 1.5 * fits.stddev.translation_m.norm());
    // Wider, and rightly so.
    const Rigid3 error = scene.rig.cameras[c].lidar_from_camera.Inverse() *
                         bad->result.rig.cameras[c].lidar_from_camera;
    const Eigen::Vector3d sigmas =
        error.translation.cwiseQuotient(does_not.stddev.translation_m).cwiseAbs();
    EXPECT_LT(sigmas.maxCoeff(), 3.0);
  }
}

TEST(RigCalibrator, ARollingShutterThatTheRigFileGivesIsAsGoodAsAGlobalOne) {
  std::vector<CameraConfig> cameras = TwoCameras();
  for (CameraConfig& camera : cameras) camera.rolling_shutter_line_time_s = 3e-5;
  const CanyonScene scene = MakeCanyonScene(cameras, {});
  const auto calibration = CalibrateRig(Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8), scene.map,
                                        scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    EXPECT_TRUE(calibration->result.cameras[c].accepted);
    const PoseError error = ErrorOf(scene.rig.cameras[c], calibration->result.rig.cameras[c]);
    EXPECT_LT(error.rotation_deg, 0.03);
    EXPECT_LT(error.translation_m, 0.015);
  }
}

TEST(RigCalibrator, ARollingShutterThatNobodyMentionedIsRefusedAndMeasured) {
  std::vector<CameraConfig> cameras = TwoCameras();
  cameras[1].rolling_shutter_line_time_s = 3e-5;
  const CanyonScene scene = MakeCanyonScene(cameras, {});
  Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8);
  initial.cameras[1].rolling_shutter_line_time_s.reset();
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  const CameraQuality& global = calibration->result.cameras[0];
  EXPECT_TRUE(global.accepted) << (global.reasons.empty() ? "" : global.reasons[0]);
  const CameraQuality& rolling = calibration->result.cameras[1];
  EXPECT_FALSE(rolling.accepted);
  const auto reason = std::find_if(
      rolling.reasons.begin(), rolling.reasons.end(),
      [](const std::string& text) { return text.find("row by row") != std::string::npos; });
  ASSERT_NE(reason, rolling.reasons.end());
  const std::string before = "row by row, about ";
  const double told_us = std::stod(reason->substr(reason->find(before) + before.size()));
  // Enough to know what to look for in the sensor's data sheet.
  EXPECT_GT(told_us, 18.0) << *reason;
  EXPECT_LT(told_us, 33.0) << *reason;
  EXPECT_NE(reason->find("rolling_shutter_line_time_s"), std::string::npos) << *reason;
}

/// Stamps that come so much before the lidar clock's.
void SetClock(double offset_s, CameraSegment* segment) {
  for (Track& track : segment->tracks) {
    for (TrackObservation& observation : track.observations) {
      observation.stamp_ns = AddSeconds(observation.stamp_ns, -offset_s);
    }
  }
}

TEST(RigCalibrator, AClockThatIsOffIsToldOfWidensTheDeviationsOrIsRefused) {
  CanyonOptions canyon;
  canyon.turn_amplitude_rad = 0.6;
  canyon.tracks_per_camera = 1000;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), canyon);
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8);
  const auto with_clock = [&](double offset_s) {
    CanyonScene late = scene;
    SetClock(offset_s, &late.segments[1]);
    const auto calibration = CalibrateRig(initial, late.map, late.segments, HeldIntrinsics(), {});
    EXPECT_TRUE(calibration.ok()) << calibration.status().message();
    EXPECT_TRUE(calibration->result.cameras[0].accepted);
    return calibration->result;
  };
  const auto told = [](const CameraQuality& quality) {
    const std::string before = "they ask for a time_offset_s of ";
    for (const std::string& reason : quality.reasons) {
      const std::size_t at = reason.find(before);
      if (at != std::string::npos) return 1e-3 * std::stod(reason.substr(at + before.size()));
    }
    return 0.0;
  };
  const CalibrationResult right = with_clock(0.0);
  EXPECT_EQ(told(right.cameras[1]), 0.0);
  const CalibrationResult little = with_clock(0.004);
  EXPECT_TRUE(little.cameras[1].accepted);
  EXPECT_NEAR(told(little.cameras[1]), 0.004, 0.0012);
  EXPECT_EQ(told(little.cameras[0]), 0.0);
  EXPECT_GT(little.cameras[1].stddev.translation_m.norm(),
            2.0 * right.cameras[1].stddev.translation_m.norm());
  const Eigen::Vector3d sigmas =
      (scene.rig.cameras[1].lidar_from_camera.Inverse() * little.rig.cameras[1].lidar_from_camera)
          .translation.cwiseQuotient(little.cameras[1].stddev.translation_m);
  EXPECT_LT(sigmas.cwiseAbs().maxCoeff(), 3.0);
  const CalibrationResult much = with_clock(0.015);
  EXPECT_FALSE(much.cameras[1].accepted);
  EXPECT_NEAR(told(much.cameras[1]), 0.015, 0.003);
}

TEST(RigCalibrator, RecoversTimeOffsetsWhenAskedTo) {
  constexpr double kOffset_s = 0.01;  // camera stamp + offset = lidar clock
  CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  for (CameraSegment& segment : scene.segments) SetClock(kOffset_s, &segment);
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8);
  CalibrationOptions options = HeldIntrinsics();
  options.estimate_time_offset = true;
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, options, {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  for (const CameraConfig& camera : calibration->result.rig.cameras) {
    // On a winding drive at constant speed: a tenth of the offset.
    EXPECT_NEAR(camera.time_offset_s, kOffset_s, 0.1 * kOffset_s) << camera.name;
  }
}

TEST(RigCalibrator, KeepsAPrincipalPointThatAStraightDriveDoesNotShowAndSaysSo) {
  CanyonOptions canyon;
  canyon.turn_amplitude_rad = 0.0;
  canyon.tracks_per_camera = 120;
  canyon.pixel_noise_px = 0.4;
  const CanyonScene scene = MakeCanyonScene({CanyonCamera("front", 0.0, 1500.0, false)}, canyon);
  CalibrationOptions options = HeldIntrinsics();
  options.hold_intrinsics = false;
  options.acceptance.min_inlier_tracks = 20;
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 8);
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, options, {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  const CameraQuality& quality = calibration->result.cameras[0];
  const Eigen::Vector2d moved_px =
      calibration->result.rig.cameras[0].model->tunable().principal_point_px -
      initial.cameras[0].model->tunable().principal_point_px;
  const double prior_px =
      options.prior.principal_point_share * initial.cameras[0].model->width_px();
  EXPECT_LT(moved_px.norm(), 0.5 * prior_px);
  // What stays because it is not shown is as unknown as its prior says, and so is what depends on
  // it.
  EXPECT_GT(quality.stddev.principal_point_px.y(), 0.5 * prior_px);
  const double pitch_of_principal_point = quality.stddev.principal_point_px.y() / 1500.0;
  EXPECT_GT(quality.stddev.rotation_rad.x(), 0.5 * pitch_of_principal_point);
  bool said = false;
  for (const std::string& reason : quality.reasons) {
    said = said || reason.find("principal point stays near its initial value") != std::string::npos;
  }
  EXPECT_TRUE(said);
}

TEST(RigCalibrator, StaysWithinTheStatedToleranceOfTheInitialValues) {
  CanyonOptions canyon;
  canyon.tracks_per_camera = 200;
  const CanyonScene scene = MakeCanyonScene({CanyonCamera("front", 0.0, 680.0, false)}, canyon);
  Rig initial = scene.rig;
  CameraConfig& camera = initial.cameras[0];
  camera.lidar_from_camera =
      camera.lidar_from_camera * Rigid3(ExpSo3({0.0, 0.0, 0.0}), {0.03, 0, 0.05});
  camera.initial_stddev.translation_m = Eigen::Vector3d(0.2, 0.2, 1e-5);
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  const Eigen::Vector3d moved =
      (camera.lidar_from_camera.Inverse() * calibration->result.rig.cameras[0].lidar_from_camera)
          .translation;
  EXPECT_NEAR(moved.z(), 0.0, 1e-3) << "forward is said to be known";
  EXPECT_LT(moved.x(), -0.01) << "right is not";
}

TEST(RigCalibrator, SameInputGivesTheSameResultToTheLastBit) {
  CanyonOptions canyon;
  canyon.tracks_per_camera = 250;
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), canyon);
  const Rig initial = Perturb(scene.rig, 1.0 / kDegPerRad, 0.1, 4);
  const auto first = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  const auto second = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(first.ok() && second.ok());
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    const Rigid3& a = first->result.rig.cameras[c].lidar_from_camera;
    const Rigid3& b = second->result.rig.cameras[c].lidar_from_camera;
    EXPECT_EQ(a.translation, b.translation);
    EXPECT_EQ(a.rotation.coeffs(), b.rotation.coeffs());
  }
}

TEST(RigCalibrator, CameraWithoutTracksKeepsItsInitialValuesAndSaysWhy) {
  CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  scene.segments[1].tracks.clear();
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 6);
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(calibration.ok());
  EXPECT_TRUE(calibration->result.cameras[0].accepted);
  EXPECT_FALSE(calibration->result.cameras[1].accepted);
  ASSERT_FALSE(calibration->result.cameras[1].reasons.empty());
  EXPECT_NE(calibration->result.cameras[1].reasons[0].find("left: only 0 feature tracks"),
            std::string::npos);
  EXPECT_EQ(calibration->result.rig.cameras[1].lidar_from_camera.translation,
            initial.cameras[1].lidar_from_camera.translation);
  EXPECT_FALSE(calibration->result.accepted);
}

TEST(RigCalibrator, SurvivesAThirdOfTheTracksBeingOnMovingObjects) {
  CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  for (CameraSegment& segment : scene.segments) {
    for (std::size_t i = 0; i < segment.tracks.size(); i += 3) {
      std::vector<TrackObservation>& observations = segment.tracks[i].observations;
      for (std::size_t k = 0; k < observations.size(); ++k) {
        observations[k].pixel.x() += 2.0 * static_cast<double>(k);  // drives to the right
      }
    }
  }
  const Rig initial = Perturb(scene.rig, 1.0 / kDegPerRad, 0.1, 2);
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
    EXPECT_TRUE(calibration->result.cameras[c].accepted);
    // As without the moving objects, from two thirds of the tracks.
    const PoseError error = ErrorOf(scene.rig.cameras[c], calibration->result.rig.cameras[c]);
    EXPECT_LT(error.rotation_deg, 0.03);
    EXPECT_LT(error.translation_m, 0.015);
  }
}

TEST(RigCalibrator, RandomTracksAreNotAccepted) {
  CanyonScene scene = MakeCanyonScene({CanyonCamera("front", 0.0, 680.0, false)}, {});
  Random random(9);
  for (Track& track : scene.segments[0].tracks) {
    for (TrackObservation& observation : track.observations) {
      observation.pixel = {random.Uniform(0.0, 959.0), random.Uniform(0.0, 599.0)};
    }
  }
  const Rig initial = Perturb(scene.rig, 0.5 / kDegPerRad, 0.05, 7);
  const auto calibration = CalibrateRig(initial, scene.map, scene.segments, HeldIntrinsics(), {});
  if (calibration.ok()) {
    EXPECT_FALSE(calibration->result.cameras[0].accepted);
    EXPECT_EQ(calibration->result.rig.cameras[0].lidar_from_camera.translation,
              initial.cameras[0].lidar_from_camera.translation);
  } else {
    EXPECT_EQ(calibration.status().code(), Status::Code::kInsufficientData);
  }
}

TEST(RigCalibrator, CanBeCancelled) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  const auto calibration = CalibrateRig(scene.rig, scene.map, scene.segments, HeldIntrinsics(),
                                        [](const Progress&) { return false; });
  ASSERT_FALSE(calibration.ok());
  EXPECT_EQ(calibration.status().code(), Status::Code::kCancelled);
}

TEST(RigCalibrator, WorkBesideTheJointRoundsHearsThatTheyFailed) {
  if (std::thread::hardware_concurrency() < 2) GTEST_SKIP() << "nothing runs beside anything here";
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  const Result<RayCaster> surfaces = RayCaster::Create(scene.map);
  ASSERT_TRUE(surfaces.ok());
  const auto until_joint = [](const Progress& progress) {
    return progress.stage.find("joint") == std::string::npos;
  };
  bool has_heard = false;
  const auto beside = [&has_heard](const std::atomic<bool>& cancelled) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
    while (!cancelled && std::chrono::steady_clock::now() < end) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    has_heard = cancelled;
  };
  const auto calibration = CalibrateRig(scene.rig, scene.map, *surfaces, scene.segments,
                                        HeldIntrinsics(), until_joint, beside);
  EXPECT_EQ(calibration.status().code(), Status::Code::kCancelled);
  EXPECT_TRUE(has_heard);
}

TEST(RigCalibrator, WorkBesideEndsBeforeTheCalibration) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  const Result<RayCaster> surfaces = RayCaster::Create(scene.map);
  ASSERT_TRUE(surfaces.ok());
  bool was_cancelled = true;
  const auto calibration =
      CalibrateRig(scene.rig, scene.map, *surfaces, scene.segments, HeldIntrinsics(), {},
                   [&was_cancelled](const std::atomic<bool>& cancelled) {
                     std::this_thread::sleep_for(std::chrono::milliseconds(20));
                     was_cancelled = cancelled;
                   });
  EXPECT_TRUE(calibration.ok());
  EXPECT_FALSE(was_cancelled);
}

TEST(RigCalibrator, EmptyMapIsRefused) {
  const CanyonScene scene = MakeCanyonScene(TwoCameras(), {});
  EXPECT_FALSE(CalibrateRig(scene.rig, SceneMap(), scene.segments, HeldIntrinsics(), {}).ok());
}

}  // namespace
}  // namespace scenecalib
