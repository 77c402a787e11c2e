#!/bin/sh
# ExecStopPost= of drivegate@.service: repeated starts that never became ready are spaced by 0, 1, 2, 4, 8, 15 s.
# systemd has such steps itself only from 254 on (RestartSteps=). The unit forgets the count as soon as it is ready.
[ "$SERVICE_RESULT" = success ] && exit 0
[ "$EXIT_STATUS" = 78 ] && exit 0 # a wrong robot file: not restarted at all
file=$RUNTIME_DIRECTORY/failures
count=0
[ -r "$file" ] && read -r count <"$file"
echo $((count + 1)) >"$file"
case $count in
    0) exit 0 ;;
    1) pause=1 ;;
    2) pause=2 ;;
    3) pause=4 ;;
    4) pause=8 ;;
    *) pause=15 ;;
esac
echo "failed $count times before it was ready: next start in $pause s"
exec sleep "$pause"
