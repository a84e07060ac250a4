# runs decks one after another: each line of stdin has a folder and a word to print when the deck of the folder is done
while IFS= read -r line; do
    [ -z "${line% *}" ] || (cd "${line% *}" && exec "$@" < /dev/null) || exit
    echo "${line##* }"
done
