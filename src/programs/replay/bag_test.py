#!/usr/bin/env python3
"""Runs soft_volume_replay as a test: for ctest by its exit code, for rostest and catkin by a result file.

Usage: bag_test BAG OPTIONS OF soft_volume_replay... [--gtest_output=xml:FILE]

Everything but --gtest_output goes to soft_volume_replay, which lies beside this program; names and remappings that
roslaunch appends are left out. A bag that --resimulate wrote is removed after a success.
"""

import os
import re
import subprocess
import sys
import time
from xml.sax.saxutils import escape, quoteattr


def split_arguments(arguments):
  """Arguments for soft_volume_replay, and the path of the result file or None."""
  result = None
  passed = []
  for argument in arguments:
    if argument.startswith('--gtest_output='):
      result = argument[len('--gtest_output='):]
      result = result[len('xml:'):] if result.startswith('xml:') else result
    elif not re.match(r'^_{0,2}[A-Za-z/~][\w/]*:=', argument):
      passed.append(argument)
  return passed, result


def write_result(path, name, seconds, failure):
  """A JUnit file with one test; `failure` is its text, or None."""
  # XML has no control characters.
  text = None if failure is None else re.sub('[^\t\n -\ud7ff\ue000-\ufffd]', '?', failure)
  body = '' if text is None else '<failure message=%s type="">%s</failure>' % (
      quoteattr(text.strip().rsplit('\n', 1)[-1]), escape(text))
  os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
  with open(path, 'w', encoding='utf-8') as file:
    file.write('<?xml version="1.0" encoding="utf-8"?>\n'
               '<testsuite name="bag_test" tests="1" failures="%d" errors="0" time="%.3f">\n'
               '<testcase name=%s classname="bag_test" time="%.3f">%s</testcase>\n</testsuite>\n' %
               (failure is not None, seconds, quoteattr(name), seconds, body))


def main():
  arguments, result = split_arguments(sys.argv[1:])
  program = os.path.join(os.path.dirname(os.path.realpath(__file__)), 'soft_volume_replay')
  start = time.monotonic()
  run = subprocess.run([program] + arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
  seconds = time.monotonic() - start
  output = run.stdout.decode('utf-8', 'replace')
  sys.stdout.write(output)
  if run.returncode == 0 and '--output' in arguments[:-1]:
    os.remove(arguments[arguments.index('--output') + 1])
  if result:
    name = os.path.splitext(os.path.basename(arguments[0]))[0] if arguments else 'bag'
    write_result(result, name, seconds, None if run.returncode == 0 else output)
  return run.returncode


if __name__ == '__main__':
  sys.exit(main())
