#!/usr/bin/python3
"""Sums the results of tests: summarise_tests.py RESULTS [NAME=COMMAND]...

Reads every JUnit file below RESULTS (gtest and rostest), runs each COMMAND as one test more, lists
what failed, and ends with "N passed, N failed". Exit status 1 when a test failed or there was none.
"""
import pathlib
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ElementTree


def read_results(directory):
    """Names of the tests that passed and that failed."""
    passed, failed = [], []
    for path in sorted(pathlib.Path(directory).rglob('*.xml')):
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as error:
            failed.append(f'{path}: {error}')
            continue
        for case in root.iter('testcase'):
            name = f"{case.get('classname', '')}.{case.get('name', '')}"
            bad = case.find('failure') is not None or case.find('error') is not None
            if case.get('status') == 'notrun' or case.find('skipped') is not None:
                continue
            # rostest adds one case per .test file, rostest-*.xml: that it ran to its end.
            (failed if bad else passed).append(name)
    return passed, failed


def main(arguments):
    passed, failed = read_results(arguments[0])
    for argument in arguments[1:]:
        name, command = argument.split('=', 1)
        run = subprocess.run(shlex.split(command), check=False)
        (failed if run.returncode else passed).append(name)
    for name in failed:
        print(f'FAILED {name}')
    print(f'{len(passed)} passed, {len(failed)} failed')
    return 1 if failed or not passed else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
