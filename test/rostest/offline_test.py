#!/usr/bin/python3
"""calibrate_bag on a small recording, and every way in which it must refuse."""
import filecmp
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

import rosbag
import rospy
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import recording  # noqa: E402


class CalibrateBag(unittest.TestCase):
    """Runs the program as a user does, without a master."""

    @classmethod
    def setUpClass(cls):
        cls.binaries = rospy.get_param('~binaries')
        cls.recording = recording.make(cls.binaries, rospy.get_param('~data'))
        cls.bag = os.path.join(cls.recording, 'recording.bag')
        cls.rig = os.path.join(cls.recording, 'rig_initial.yaml')
        cls.truth = os.path.join(cls.recording, 'truth.yaml')

    def setUp(self):
        self.directory = tempfile.mkdtemp(prefix='scenecalib_offline_')
        self.output = os.path.join(self.directory, 'result')

    def tearDown(self):
        shutil.rmtree(self.directory)

    def run_program(self, *arguments, bag=None, rig=None, output=None):
        environment = dict(os.environ, ROS_MASTER_URI='http://localhost:1')  # nobody there
        return subprocess.run(
            [os.path.join(self.binaries, 'calibrate_bag'), '--bag', bag or self.bag, '--rig',
             rig or self.rig, '--output', output or self.output, *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True,
            env=environment, timeout=600, check=False)

    def expect_refusal(self, words, **arguments):
        """Exit status 1, one line that has all the words, and the earlier output as it was."""
        os.makedirs(self.output)
        earlier = os.path.join(self.output, 'calibration.yaml')
        with open(earlier, 'w', encoding='utf-8') as stream:
            stream.write('earlier')
        run = self.run_program(**arguments)
        self.assertEqual(run.returncode, 1, run.stdout + run.stderr)
        lines = [line for line in run.stderr.splitlines() if line.startswith('calibrate_bag:')]
        self.assertEqual(len(lines), 1, run.stderr)
        for word in words:
            self.assertIn(word, lines[0])
        with open(earlier, encoding='utf-8') as stream:
            self.assertEqual(stream.read(), 'earlier')
        self.assertEqual(os.listdir(self.output), ['calibration.yaml'])

    def changed_rig(self, change):
        with open(self.rig, encoding='utf-8') as stream:
            rig = yaml.safe_load(stream)
        change(rig)
        path = os.path.join(self.directory, 'rig.yaml')
        with open(path, 'w', encoding='utf-8') as stream:
            yaml.safe_dump(rig, stream, sort_keys=False)
        return path

    def test_calibrates_within_bounds_and_is_deterministic(self):
        first = self.run_program('--truth', self.truth)
        self.assertEqual(first.returncode, 0, first.stdout + first.stderr)
        result = os.path.join(self.output, 'calibration.yaml')
        truth = recording.lidar_from_camera(self.truth)
        estimate = recording.lidar_from_camera(result)
        self.assertEqual(list(estimate), list(truth))
        for camera in truth:
            rotation_deg, distance_m = recording.errors(estimate[camera], truth[camera])
            self.assertLess(rotation_deg, recording.MAX_ROTATION_DEG, camera)
            self.assertLess(distance_m, recording.MAX_TRANSLATION_M, camera)
            for when in ('before', 'after'):
                self.assertTrue(os.path.exists(
                    os.path.join(self.output, 'overlays', f'{camera}_{when}.png')))
        self.assertTrue(os.path.exists(os.path.join(self.output, 'trajectory.tum')))

        again = os.path.join(self.directory, 'again')
        second = self.run_program('--threads', '1', output=again)
        self.assertEqual(second.returncode, 0, second.stdout + second.stderr)
        self.assertTrue(filecmp.cmp(result, os.path.join(again, 'calibration.yaml'), shallow=False),
                        'one thread and all threads give different calibrations')

    def test_reads_what_is_left_of_a_truncated_bag_and_says_so(self):
        bag = os.path.join(self.directory, 'cut.bag')
        shutil.copy(self.bag, bag)
        os.truncate(bag, int(0.85 * os.path.getsize(bag)))
        run = self.run_program(bag=bag)
        self.assertIn(run.returncode, (0, 2), run.stdout + run.stderr)
        self.assertIn('cut off', run.stdout)

    def test_refuses_a_missing_topic(self):
        rig = self.changed_rig(lambda r: r['lidar'].update(topic='/no/such/points'))
        self.expect_refusal(['/no/such/points', 'lidar.topic', '/lidar/points'], rig=rig)

    def test_refuses_a_topic_of_the_wrong_type(self):
        def swap(rig):
            rig.pop('imu')
            rig['lidar']['topic'] = '/imu/data'
        rig = self.changed_rig(swap)
        self.expect_refusal(['/imu/data', 'sensor_msgs/Imu', 'sensor_msgs/PointCloud2'], rig=rig)

    def test_refuses_an_unknown_rig_key(self):
        rig = self.changed_rig(lambda r: r['lidar'].update(colour='red'))
        self.expect_refusal(['rig.yaml', 'colour'], rig=rig)

    def test_refuses_an_empty_bag(self):
        bag = os.path.join(self.directory, 'empty.bag')
        rosbag.Bag(bag, 'w').close()
        self.expect_refusal(['empty.bag'], bag=bag)

    def test_refuses_a_bag_cut_down_to_nothing(self):
        bag = os.path.join(self.directory, 'cut.bag')
        shutil.copy(self.bag, bag)
        os.truncate(bag, 5000)
        self.expect_refusal(['cut.bag'], bag=bag)

    def test_refuses_a_file_that_does_not_exist(self):
        self.expect_refusal(['/nowhere.bag'], bag='/nowhere.bag')
        shutil.rmtree(self.output)
        self.expect_refusal(['/nowhere.yaml'], rig='/nowhere.yaml')

    def test_refuses_a_vehicle_that_stands_still(self):
        """One scan again and again, with stamps that go on."""
        path = recording.write_standing_still(self.bag, os.path.join(self.directory, 'still.bag'))

        def without_motion_sensors(rig):
            rig.pop('imu', None)
            rig.pop('odometry', None)
        self.expect_refusal(['did not move'], bag=path, rig=self.changed_rig(without_motion_sensors))

    def test_combines_the_best_stretches_of_a_long_recording_and_names_them(self):
        config = os.path.join(self.directory, 'long.yaml')
        with open(config, 'w', encoding='utf-8') as stream:  # the test's recording counts as long
            stream.write('segment: {min_recording_m: 5, max_length_m: 20, bin_length_m: 1}\n')
        run = self.run_program('--config', config)
        self.assertIn(run.returncode, (0, 2), run.stdout + run.stderr)
        self.assertIn('stretch 1 of those with most excitation', run.stdout)
        with open(os.path.join(self.output, 'trajectory.tum'), encoding='utf-8') as stream:
            stamps = [float(line.split()[0]) for line in stream if not line.startswith('#')]
        with rosbag.Bag(self.bag) as bag:
            self.assertLess(stamps[-1] - stamps[0], 0.95 * (bag.get_end_time() - bag.get_start_time()))

    def bag_with_front_images(self, change):
        return recording.write_changed(self.bag, os.path.join(self.directory, 'changed.bag'),
                                       ['front'], change)

    def only_front(self):
        return self.changed_rig(lambda rig: rig['cameras'].pop('left'))

    def test_refuses_night(self):
        self.expect_refusal(['front', 'too dark', 'limit'],
                            bag=self.bag_with_front_images(recording.night), rig=self.only_front())

    def test_refuses_rain(self):
        self.expect_refusal(['front', 'rain', 'limit'],
                            bag=self.bag_with_front_images(recording.rain), rig=self.only_front())

    def test_refuses_snow(self):
        self.expect_refusal(['front', 'snow', 'limit'],
                            bag=self.bag_with_front_images(recording.snow), rig=self.only_front())

    def test_refuses_a_camera_that_sees_only_the_sky(self):
        self.expect_refusal(['front', 'sky', 'limit'],
                            bag=self.bag_with_front_images(recording.sky), rig=self.only_front())

    def test_a_camera_at_night_keeps_the_values_of_the_fallback(self):
        good = self.run_program()
        self.assertEqual(good.returncode, 0, good.stdout + good.stderr)
        fallback = os.path.join(self.output, 'calibration.yaml')
        rig = self.changed_rig(lambda r: r.update(fallback=fallback))
        output = os.path.join(self.directory, 'night')
        run = self.run_program(bag=self.bag_with_front_images(recording.night), rig=rig, output=output)
        self.assertEqual(run.returncode, 2, run.stdout + run.stderr)
        with open(os.path.join(output, 'calibration.yaml'), encoding='utf-8') as stream:
            quality = yaml.safe_load(stream)['cameras']['front']['quality']
        self.assertFalse(quality['accepted'])
        self.assertTrue(any('too dark' in reason for reason in quality['reasons']))
        self.assertTrue(any(fallback in reason for reason in quality['reasons']))
        self.assertEqual(recording.lidar_from_camera(fallback)['front'],
                         recording.lidar_from_camera(os.path.join(output, 'calibration.yaml'))['front'])
        compared = subprocess.run([os.path.join(self.binaries, 'compare'), fallback, fallback],
                                  stdout=subprocess.PIPE, universal_newlines=True, check=False)
        self.assertEqual(compared.returncode, 0, compared.stdout)
        self.assertIn('front: did not move', compared.stdout)

    def test_the_truth_has_lower_miscalibration_rates_than_the_start(self):
        run = subprocess.run(
            [os.path.join(self.binaries, 'evaluate_calibration'), '--bag', self.bag, '--rig',
             self.truth, '--rig', self.rig, '--output', self.output],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True, timeout=600,
            check=False)
        self.assertEqual(run.returncode, 0, run.stdout + run.stderr)
        with open(os.path.join(self.output, 'miscalibration_rates.yaml'), encoding='utf-8') as stream:
            of_truth, of_start = yaml.safe_load(stream)['miscalibration_rates']
        for camera, rates in of_truth['cameras'].items():
            mean = sum(rates.values()) / 6
            self.assertLess(mean, sum(of_start['cameras'][camera].values()) / 6, camera)

    def test_refuses_lidar_stamps_that_jump(self):
        path = os.path.join(self.directory, 'jump.bag')
        count = 0
        with rosbag.Bag(self.bag) as source, rosbag.Bag(path, 'w') as target:
            for topic, message, stamp in source.read_messages():
                if topic == '/lidar/points':
                    count += 1
                    if count > 20:
                        message.header.stamp += rospy.Duration(60)
                target.write(topic, message, stamp)
        self.expect_refusal(['/lidar/points', 'jump by 60'], bag=path)


if __name__ == '__main__':
    rospy.init_node('offline_test')
    rostest.rosrun('scenecalib', 'offline', CalibrateBag)
