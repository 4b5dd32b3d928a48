#!/usr/bin/python3
"""The launch files of the offline programs, as a user calls them: with relative paths."""
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

import rospy
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import recording  # noqa: E402

MAX_TURN_DEG = 0.05  # small starts: what is tested is the launch file, not the range


class Launch(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        made = recording.make(rospy.get_param('~binaries'), rospy.get_param('~data'))
        cls.directory = tempfile.mkdtemp(prefix='scenecalib_launch_')
        for name in ('recording.bag', 'rig_initial.yaml', 'truth.yaml'):
            os.symlink(os.path.join(made, name), os.path.join(cls.directory, name))

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.directory)

    def launch(self, name, *arguments):
        run = subprocess.run(['roslaunch', 'scenecalib', name, *arguments], cwd=self.directory,
                             env=dict(os.environ, PWD=self.directory), stdout=subprocess.PIPE,
                             stderr=subprocess.STDOUT, universal_newlines=True, timeout=600,
                             check=False)
        return run.stdout

    def test_evaluate_calibration_rates_every_file(self):
        said = self.launch('evaluate_calibration.launch', 'bag:=recording.bag',
                           'rig:=truth.yaml,rig_initial.yaml', 'output:=rates')
        path = os.path.join(self.directory, 'rates', 'miscalibration_rates.yaml')
        self.assertTrue(os.path.exists(path), said)
        with open(path, encoding='utf-8') as stream:
            rates = yaml.safe_load(stream)['miscalibration_rates']
        self.assertEqual([rated['rig'] for rated in rates], ['truth.yaml', 'rig_initial.yaml'])

    def test_study_writes_its_page(self):
        said = self.launch('study.launch', 'bag:=recording.bag', 'rig:=truth.yaml', 'output:=study',
                           'starts:=2', f'max_deg:={MAX_TURN_DEG}', 'max_m:=0.01', 'seed:=3')
        for name in ('study.csv', 'study.html'):
            self.assertTrue(os.path.exists(os.path.join(self.directory, 'study', name)), said)

    def test_compare_says_that_nothing_moved(self):
        calibrated = self.launch('calibrate_bag.launch', 'bag:=recording.bag',
                                 'rig:=rig_initial.yaml', 'output:=result')
        self.assertTrue(
            os.path.exists(os.path.join(self.directory, 'result', 'calibration.yaml')), calibrated)
        said = self.launch('compare.launch', 'sigmas:=4',
                           'files:=result/calibration.yaml,result/calibration.yaml')
        self.assertIn('front: did not move', said)

    def test_a_file_that_does_not_exist_is_named(self):
        for name, argument in (('evaluate_calibration.launch', 'bag:=nowhere.bag'),
                               ('study.launch', 'bag:=nowhere.bag')):
            self.assertIn('nowhere.bag', self.launch(name, argument, 'rig:=truth.yaml'))
        self.assertIn('nowhere.yaml',
                      self.launch('compare.launch', 'files:=nowhere.yaml,truth.yaml'))


if __name__ == '__main__':
    rospy.init_node('launch_test')
    rostest.rosrun('scenecalib', 'launch', Launch)
